"""A process that hangs in compiled code, or dies, is replaced, and all other cases are read."""

import importlib
import os
import time
from zlib import crc32

import numpy as np
import pytest

from egocap_eval.fuzz.mutations import mutated
from egocap_eval.fuzz.trials import Failure
from egocap_eval.fuzz.watchdog import Batch, watch

MODULE = """
import ctypes, os, zlib
from egocap.errors import FileError
from egocap_eval.fuzz.targets import Target

def load(path):
    content = path.read_bytes()
    if content == b"1 2 3":
        return
    kind = zlib.crc32(content) % 8
    if kind == 0:
        ctypes.PyDLL(None).sleep(600)  # PyDLL keeps the GIL: no other thread, no signal handler
    if kind == 1:
        os._exit(7)
    if kind == 2:
        raise KeyError(kind)
    raise FileError(path, "refused")

def make(folder):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "a.txt").write_text("1 2 3")
    (folder / "pid").open("a").write(f"{os.getpid()} ")
    return Target("a", folder / "a.txt", load)

def never(folder):
    raise OSError("no valid file")
"""


@pytest.fixture
def made(tmp_path, monkeypatch):
    """A module that worker processes can import, too."""
    (tmp_path / "hanging_target.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    return importlib.import_module("hanging_target")


def test_hung_and_dead_processes_are_replaced_and_their_cases_count(made, tmp_path):
    cases, seed, work = range(3, 10), 30, tmp_path / "work"
    kinds = [crc32(mutated(b"1 2 3", ".txt", np.random.default_rng([seed, case]))) % 8
             for case in cases]  # fmt: skip
    assert [kinds.count(kind) for kind in range(3)] == [1, 1, 1]
    ((batch, counts),) = watch([Batch("a", made.make, work, cases, seed)], 1, limit_s=1.0)
    assert batch.cases == cases
    assert counts.read + counts.refused == len(cases) - 3
    words = ("hangs: killed after 1 s", "its process died, exit code 7", "KeyError: 2")
    assert set(counts.failures) == {
        Failure("a", seed, case, words[kind])
        for case, kind in zip(cases, kinds, strict=True) if kind < 3
    }  # fmt: skip
    assert counts.hung == 1
    for failure in counts.failures:
        assert (work / f"failed-{failure.case}.txt").is_file()
    pids = (work / "valid" / "pid").read_text().split()
    assert len(pids) == 3 and not any(_lives(pid) for pid in pids)


def test_a_process_that_does_not_start_is_no_endless_loop(made, tmp_path, capfd):
    batches = [Batch(name, made.never, tmp_path / name, range(2)) for name in "ab"]
    found = {batch.name: counts for batch, counts in watch(batches, 2)}
    assert found.keys() == {"a", "b"}
    for counts in found.values():
        (failure,) = counts.failures
        assert failure.what == "its process died, exit code 1, in no case; 2 cases are left out"
    assert "no valid file" in capfd.readouterr().err


def test_the_end_of_the_parent_loop_kills_the_workers(made, tmp_path):
    work = tmp_path / "work"
    running = watch([Batch("b", made.never, tmp_path / "b", range(2)),
                     Batch("a", made.make, work, range(1000))], 2, limit_s=600.0)  # fmt: skip
    next(running)
    until = time.monotonic() + 60.0
    while not (work / "valid" / "pid").exists() and time.monotonic() < until:
        time.sleep(0.05)
    running.close()
    assert not any(_lives(pid) for pid in (work / "valid" / "pid").read_text().split())


def _lives(pid):
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    return True
