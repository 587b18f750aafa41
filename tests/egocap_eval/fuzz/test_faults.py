"""A sound command passes every fault; one that loses or leaves something is found out."""

import pytest

from egocap.errors import InputError
from egocap_eval.fuzz import faults

SLOPPY = """
import subprocess, sys, time
from pathlib import Path

def main():
    open("o/a.npz", "wb").write(b"PK half")
    again = Path("o/again").exists()
    Path("o/again").touch()
    wait = [sys.executable, "-c", "import time; time.sleep(5)"]
    subprocess.Popen(wait, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    time.sleep(0.6)
    Path("o/b.json").write_text("{}")
    Path("o/c.json").write_text("{}") if again else None
    return 0

if __name__ == "__main__":
    raise SystemExit(main())
"""


def test_an_export_survives_every_fault(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    found = faults.study(tmp_path, only=("export",), kills=2)
    assert found.missed == []
    assert found.result["commands"]["export"]["faults"]["kill"] == 2


def test_broken_files_processes_and_other_files_are_found(tmp_path, monkeypatch):
    (tmp_path / "sloppy.py").write_text(SLOPPY)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(faults, "_ENDED_S", 0.5)
    trial = faults.Trial("sloppy", ["sloppy"], tmp_path / "work")
    trial.clear()
    trial.files = {"o/a.npz", "o/b.json", "o/again"}
    faults._interrupt(trial, "kill", 9, 0.5, ())
    trial.finish("kill")
    said = "\n".join(trial.problems)
    assert "is left" in said and "a broken file: " in said and "o/c.json" in said


@pytest.mark.parametrize("options", [{"only": ("nothing",)}, {"kills": -1}])
def test_impossible_wishes_are_refused(tmp_path, options):
    with pytest.raises(InputError):
        faults.study(tmp_path, **options)
