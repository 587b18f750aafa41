"""Training for a rig: options, calls of egocap-sim, resuming, failure."""

import subprocess

import pytest

from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError, MachineError
from egocap_eval.detection import train_for_rig as simulation
from egocap_eval.detection.train_for_rig import RigRunConfig, simulate_for_rig
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


def test_seeds_differ_and_at_least_two_sequences_are_made(rig, tmp_path, asked):
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    assert len(asked) == 2
    seeds = [int(words[words.index("--seed") + 1]) for words in asked]
    assert seeds == [simulation.FIRST_SEED, simulation.FIRST_SEED + 1]
    assert all(words[words.index("--rig") + 1] == str(rig) for words in asked)


def test_existing_sequences_are_kept(rig, tmp_path, asked):
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    asked.clear()
    simulate_for_rig(rig, tmp_path / "out", 0.0)
    assert not asked


def test_failure_is_reported(rig, tmp_path, monkeypatch):
    failed = subprocess.CompletedProcess([], 1, "", "loading\negocap-sim: no OpenGL here\n")
    monkeypatch.setattr(simulation.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(MachineError, match="no OpenGL here"):
        simulate_for_rig(rig, tmp_path / "out", 0.0)


def test_run_covers_the_simulated_footage(rig, tmp_path):
    run = RigRunConfig(rig=rig, out=tmp_path, data=(tmp_path / "a",), shares=(2.0, 1.0))
    assert run.data == (tmp_path / "a", tmp_path / "simulated") and run.start is not None
    assert RigRunConfig(rig=rig, out=tmp_path, scratch=True, held_out=0.1).start is None
    with pytest.raises(InputError, match="exclude"):
        RigRunConfig(rig=rig, out=tmp_path, scratch=True, start=tmp_path)
    with pytest.raises(InputError, match="shares"):
        RigRunConfig(rig=rig, out=tmp_path, shares=(2.0, 1.0))
