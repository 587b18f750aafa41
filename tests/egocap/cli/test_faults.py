"""Faults at every write of a command: nothing half-written stays, and the same command goes on."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from egocap import cli
from egocap.posterior.backend import NpzBackend

COMMANDS = {
    "track": "track SEQ --detections simulated:2 --out o/t.npz --save-detections o/d.npz",
    "fit-body": "fit-body SEQ --detections simulated:2 --out o/body.json",
    "train": "train SEQ --out o/run --config tiny --steps 1 --batch 2 --held-out 0 --resume",
}
POSTERIOR = """posterior SEQ --frame 2 --detections simulated:2 --out o/p.npz --checkpoint o/c.npz
    --most-steps 500 --walkers 4"""
KILLED = """
import os, signal, sys
from egocap import cli
os.fsync = lambda file: os.kill(os.getpid(), signal.SIGKILL)
cli.main()
"""


@pytest.fixture(params=COMMANDS)
def words(request, tiny_sequence, tmp_path, monkeypatch):
    """A command in an empty folder."""
    if request.param == "train":
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    return words_of(COMMANDS[request.param], tiny_sequence)


def words_of(command, sequence):
    return command.replace("SEQ", str(sequence)).split()


@pytest.fixture
def run(monkeypatch, capsys):
    """Run a command with a fault before its sync of that number; gives its code and last line."""

    def run(words, number=-1, fault=None):
        count, sync = [-1], os.fsync

        def fsync(file):
            count[0] += 1
            if count[0] == number:
                fault()
            sync(file)

        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["egocap", *words])
            patch.setattr(os, "fsync", fsync)
            code = cli.main()
        err = capsys.readouterr().err
        assert "Traceback" not in err
        return code, (err.splitlines() or [""])[-1]

    return run


def files():
    return sorted(str(p) for p in Path().rglob("*") if p.is_file())


def left_overs():
    return [name for name in files() if "tmp" in name or "lock" in name]


def disk_full():
    raise OSError(errno.ENOSPC, "No space left on device")


def test_full_disk_at_any_write(words, run):
    """The same command again, each time with the fault one write later, until it is through."""
    number = 0
    while (result := run(words, number, disk_full))[0] != 0:
        assert result[0] == 1 and "disk is full; free some space" in result[1]
        assert not left_overs()
        number += 1
    assert number >= 1 and not left_overs()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_at_the_first_write(words, run, number):
    before = signal.getsignal(number)
    code, said = run(words, 0, lambda: signal.raise_signal(number))
    assert code == 130, said
    assert signal.getsignal(number) == before
    assert not left_overs()
    assert run(words)[0] == 0


def test_posterior_continues_its_chain_after_a_full_disk(run, tiny_sequence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # no copy of the chain by the clock: then the second write is that of the result
    monkeypatch.setattr(NpzBackend.__init__, "__defaults__", (1e9,))
    words = words_of(POSTERIOR, tiny_sequence)
    code, said = run(words, 1, disk_full)
    assert code == 1 and "p.npz: the disk is full" in said
    assert files() == ["o/c.npz"]
    chain = Path("o/c.npz").read_bytes()
    assert run(words)[0] == 0
    assert Path("o/c.npz").read_bytes() == chain  # no step was made again


def test_remains_of_a_killed_process_are_removed(run, tiny_sequence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = words_of(COMMANDS["track"], tiny_sequence)
    killed = subprocess.run([sys.executable, "-c", KILLED, *words], capture_output=True)
    assert killed.returncode == -signal.SIGKILL
    assert len(left_overs()) == 3  # a temporary file and two locks
    assert run(words)[0] == 0
    assert files() == ["o/d.npz", "o/t.npz"]


def test_a_folder_that_cannot_be_written_is_noticed_before_any_work(run, tiny_sequence):
    words = [w.replace("o/", "/sys/") for w in words_of(COMMANDS["track"], tiny_sequence)]
    code, said = run(words)
    assert code == 1 and "/sys" in said and "no permission" in said
