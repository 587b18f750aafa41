"""Footage for a rig: what egocap-sim is asked for, what is kept, and when it fails."""

import subprocess

import pytest

from egocap.cameras.rig_files import load_rig
from egocap.errors import MachineError
from egocap_eval.detection import train_for_rig as simulation
from egocap_eval.detection.train_for_rig import simulate_for_rig
from egocap_sim.core.resources import builtin_file


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.json"
    load_rig(builtin_file("rig", "egorig2")).to_json(path)
    return path


@pytest.fixture
def asked(monkeypatch):
    """Words of every call of egocap-sim, which is not run: it 'makes' an empty truth.npz."""
    calls = []

    def run(words, **_):
        calls.append(words)
        folder = simulation.Path(words[words.index("--out") + 1])
        folder.mkdir()
        (folder / "truth.npz").touch()
        return subprocess.CompletedProcess(words, 0, "", "")

    monkeypatch.setattr(simulation.subprocess, "run", run)
    return calls


def test_ever_other_seeds_and_at_least_two(rig, tmp_path, asked):
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    assert len(asked) == 2
    seeds = [int(words[words.index("--seed") + 1]) for words in asked]
    assert seeds == [simulation.FIRST_SEED, simulation.FIRST_SEED + 1]
    assert all(words[words.index("--rig") + 1] == str(rig) for words in asked)


def test_what_is_there_stays(rig, tmp_path, asked):
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    asked.clear()
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    assert not asked


def test_failure_is_told(rig, tmp_path, monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "loading\negocap-sim: no OpenGL here\n")
    monkeypatch.setattr(simulation.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(MachineError, match="no OpenGL here"):
        simulate_for_rig(rig, tmp_path / "out", 0.0)
