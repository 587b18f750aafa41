import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from egocap.errors import FileError, InputError
from egocap_eval.cli import main
from egocap_eval.harness.result_file import load_result
from egocap_eval.studies import physics
from egocap_eval.studies.physics import ClipResult, find_clips, run_physics
from egocap_sim.core.trajectory import PhysicsStats

CLIP = Path(__file__).parents[4] / "shared" / "motions" / "npz" / "running_5.npz"
GOOD = PhysicsStats(0.5, 1.0, 2.0, 5.0, 0.1, 1.0, 0.3, 40.0)


def clips(*stats: PhysicsStats | None) -> list[ClipResult]:
    return [ClipResult(f"clip{i}", 2.0, s, "" if s else "is broken") for i, s in enumerate(stats)]


def test_summary_takes_median_and_worst():
    r = clips(GOOD, replace(GOOD, joint_error_cm=0.7), replace(GOOD, joint_error_cm=1.9))
    assert physics.summary(r, "median")["joint_error_cm"] == 0.7
    assert physics.summary(r, "max")["joint_error_cm"] == 1.9
    assert len(physics.missed(r)) == 1 and "0.70, not 0.6" in physics.missed(r)[0]


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"joint_error_cm": 2.5}, "worst clip"),
        ({"planted_foot_speed_cm_s": 9.0}, "slide"),
        ({"penetration_cm": 2.0}, "under the floor"),
        ({"joint_error_cm": float("nan")}, "joint error"),
    ],
)
def test_every_target_can_be_missed(bad, says):
    assert any(says in line for line in physics.missed(clips(replace(GOOD, **bad))))
    assert physics.missed(clips(GOOD)) == []


def test_a_clip_that_fails_is_a_row_and_a_miss(monkeypatch):
    r = clips(GOOD, None)
    assert "clip1: is broken" in physics.missed(r)
    assert "is broken" in physics.table(r).text()
    monkeypatch.setattr(physics, "run_physics", lambda *args, **options: r)
    row = physics.study(Path()).result["per_clip"][1]
    assert row == {"name": "clip1", "seconds": 2.0, "problem": "is broken"}


def test_json_has_no_infinity_when_nothing_worked(monkeypatch):
    monkeypatch.setattr(physics, "run_physics", lambda *args, **options: clips(None))
    outcome = physics.study(Path())
    assert json.loads(outcome.to_json())["median"]["joint_error_cm"] is None
    assert outcome.missed


def test_table_has_a_row_a_clip_and_two_sums():
    assert len(physics.table(clips(GOOD, GOOD)).rows) == 2 + 2


def test_folders_without_clips_are_refused(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        find_clips(tmp_path / "nowhere")
    with pytest.raises(FileError, match="holds no motion clips"):
        find_clips(tmp_path)


def test_command_reports_bad_usage(tmp_path, capsys):
    assert main(["physics", "--motions", str(tmp_path)]) == 2
    assert "no motion clips" in capsys.readouterr().err
    assert main(["physics", "--motions", str(tmp_path), "--out", "table.csv"]) == 2


@pytest.mark.skipif(not CLIP.is_file(), reason="needs ../shared/motions")
def test_runs_a_folder_with_a_broken_clip(tmp_path, capsys):
    clips = tmp_path / "clips"
    clips.mkdir()
    shutil.copyfile(CLIP, clips / "run.npz")
    (clips / "torn.bvh").write_text("HIERARCHY\nROOT Hips\n{\n")
    out = tmp_path / "physics.json"
    assert main(["physics", "--motions", str(clips), "--out", str(out), "--json"]) == 3
    result = load_result(out)["result"]
    assert result.pop("missed")
    assert result == json.loads(capsys.readouterr().out)
    good, torn = result["per_clip"]
    assert good["joint_error_cm"] < 1.0 and good["residual_wrench_bw"] < 0.6
    assert "torn.bvh" in torn["problem"]
    with pytest.raises(InputError, match="1 to 64"):
        run_physics(clips, workers=0)
