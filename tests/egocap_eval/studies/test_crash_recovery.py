"""A generation that is killed and continued; the study must notice what it would lose."""

import sys
import textwrap

import pytest

from egocap.errors import InputError
from egocap_eval.studies import crash_recovery

SCENE = """
name = "short"
frames = 4
seed = 400210
rig = { name = "egorig1", size = [96, 80] }
motion = { name = "idle" }
place = { name = "chroma" }
episodes = { frames = [2, 2], motions = ["idle"] }
"""
BUSY = """
import multiprocessing, time
if __name__ == "__main__":
    multiprocessing.get_context("spawn").Process(target=time.sleep, args=(8,)).start()
    time.sleep(8)
"""


def test_killed_and_continued_it_is_whole_and_the_same_and_what_is_damaged_shows(tmp_path):
    scene, out = tmp_path / "short.toml", tmp_path / "out"
    scene.write_text(SCENE)
    found = crash_recovery.study(
        out, str(scene), frames=4, minutes=0.04, kills=2, workers=1, sample=1
    )
    assert found.missed == [] and found.result["frames"] == 4
    assert found.result["kills"] == 2 and found.result["compared"] == 1
    assert found.result["leftovers"] == 0
    (out / "episode-00001" / "truth.npz").write_bytes(b"")
    problems = crash_recovery.verify_dataset(out, 0)["problems"]
    assert any("episode-00001" in problem for problem in problems)


def test_parents_and_workers_are_killed_and_what_died_starts_again(tmp_path):
    script = tmp_path / "busy.py"
    script.write_text(textwrap.dedent(BUSY))
    counts = crash_recovery.run_with_kills([sys.executable, str(script)], tmp_path, 2.5, 4)
    assert counts["kills"] == counts["parents"] + counts["workers"] == 4
    assert counts["restarts"] >= counts["parents"] - 1


def test_impossible_wishes_are_refused(tmp_path):
    with pytest.raises(InputError, match="above 0"):
        crash_recovery.study(tmp_path, minutes=0.0)
