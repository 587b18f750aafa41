"""A run that gathers memory and files is told from one that does not."""

import pytest

from egocap.errors import InputError, MachineError
from egocap_eval.footage import soak

LEAK = """
import sys, time
kept, files = [], []
for i in range(60):
    if sys.argv[1] == "leak":
        kept.append(bytearray(b"x" * 1_000_000))
        files.append(open(__file__))
    time.sleep(0.05)
print("done")
sys.exit(sys.argv[1] == "fail")
"""


@pytest.fixture(autouse=True)
def script(tmp_path, monkeypatch):
    (tmp_path / "leak.py").write_text(LEAK)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(soak, "_EVERY_S", 0.02)


def test_growth_of_memory_and_files_is_found():
    leaking, sound = soak.watch(["leak", "leak"]), soak.watch(["leak", "no"])
    assert leaking["printed"] == "done\n"
    assert 25.0 < leaking["growth_mb"] < 60.0 and leaking["files_growth"] > 20
    assert len(soak._missed("a", leaking)) == 2
    assert abs(sound["growth_mb"]) < 2.0 and sound["files_growth"] == 0
    assert soak._missed("a", sound) == []


def test_a_short_run_tells_no_growth(monkeypatch):
    monkeypatch.setattr(soak, "_EVERY_S", 0.5)
    run = soak.watch(["leak", "leak"])
    assert run["growth_mb"] is None and "too short" in soak._missed("a", run)[0]


def test_failures_are_errors(tmp_path):
    with pytest.raises(MachineError, match="exited with 1"):
        soak.watch(["leak", "fail"])
    with pytest.raises(InputError):
        soak.study(minutes=0.0, work=tmp_path)
