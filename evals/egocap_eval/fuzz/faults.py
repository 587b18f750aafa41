"""Faults of every long command: killed at random moments, ended, a full disk, two writers.

Each command runs in an empty folder on tiny inputs. It is killed (SIGKILL) again and again at
seeded moments, and once while it holds its lock; stopped by SIGTERM, and by Ctrl-C once and twice;
run with a closed stdout, a disk that fills at each write, a clock that jumps back and forth, into a
folder that cannot be written, and twice at once. After each fault no process of it may be left and
every file under a final name must be whole; the same command must then end well, with the files of
an undisturbed run and no others.
"""

from __future__ import annotations

import logging
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated
from zlib import crc32

import numpy as np
from tyro.conf import arg

from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap_eval.fuzz.long_commands import COMMANDS, make_inputs
from egocap_eval.fuzz.outputs import broken_files, names
from egocap_eval.harness.study import Outcome

log = logging.getLogger(__name__)

_FULL = """
import errno, os, sys
from importlib import import_module
left, sync = [int(sys.argv.pop(1))], os.fsync
def fsync(file):
    left[0] -= 1
    if left[0] < 0:
        raise OSError(errno.ENOSPC, "No space left on device")
    sync(file)
os.fsync = fsync
package = sys.argv.pop(1)
sys.exit(import_module(f"{package}.cli").main())
"""
_JUMPS = """
import sys, time
from importlib import import_module
calls, now = [0], time.time
def jumping():
    calls[0] += 1
    return now() + 86400 * (calls[0] % 3 - 1)
time.time = jumping
package = sys.argv.pop(1)
sys.exit(import_module(f"{package}.cli").main())
"""
_AT_ONCE = 2  # commands
_MOST_S, _ENDED_S = 300.0, 10.0  # of one run; from a signal to the end of its processes
_CLOSED = (0, 1)  # exit codes with a closed stdout
_INTERRUPTED = (0, 130, -signal.SIGINT, -signal.SIGTERM)  # after SIGTERM, early or late


@dataclass
class Trial:
    """One command in its folder, and what it did wrong."""

    name: str
    words: list[str]
    folder: Path
    files: set[str] = field(default_factory=set)  # of an undisturbed run
    seconds: float = 0.0  # of it
    faults: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def start(self, words: list[str] | None = None) -> subprocess.Popen[str]:
        """Start the command in a session of its own, by which its processes are found."""
        words = words or [sys.executable, "-m", *self.words]
        return subprocess.Popen(
            words, cwd=self.folder, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def clear(self) -> None:
        """Empty the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / "o").mkdir(parents=True)

    def check(self, fault: str, said: str = "", codes: tuple[int, ...] = (), code: int = 0) -> None:
        """Count a fault; note a traceback, another exit code, processes left, broken files."""
        self.faults[fault] = self.faults.get(fault, 0) + 1
        if "Traceback" in said:
            self.problems.append(f"{self.name}, {fault}: {said.strip().splitlines()[-1][:120]}")
        if codes and code not in codes:
            self.problems.append(f"{self.name}, {fault}: exit code {code}, {said.strip()[-120:]}")
        self.problems += [f"{self.name}, {fault}: {broken}" for broken in broken_files(self.folder)]

    def finish(self, fault: str) -> None:
        """Run to the end: exit code 0 and the files of an undisturbed run."""
        run = self.start()
        _, said = run.communicate(timeout=_MOST_S)
        self.check(fault, said, (0,), run.returncode)
        self.faults[fault] -= 1
        self.compare(fault)

    def compare(self, fault: str) -> None:
        """Note files that an undisturbed run has not, or the other way round."""
        if (found := names(self.folder)) != self.files:
            odd = ", ".join(sorted(found ^ self.files)[:3])
            self.problems.append(f"{self.name}, after {fault}: other files than undisturbed: {odd}")


def study(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/faults"),
    only: tuple[str, ...] = (),
    kills: int = 20,
    seed: int = 0,
) -> Outcome:
    """Kill and disturb every long command; each must leave whole files and end well when run again.

    Args:
        work: Folder of the inputs, which are made where missing, and of the outputs.
        only: Commands to test; default: all.
        kills: Number of SIGKILLs for each command.
        seed: Seed of the moments.
    """
    if unknown := sorted(set(only) - COMMANDS.keys()):
        raise InputError(f"no command '{unknown[0]}'", valid=COMMANDS)
    if kills < 0:
        raise InputError(f"--kills {kills}", valid="0 or more")
    inputs = make_inputs((work / "inputs").absolute(), only or tuple(COMMANDS))
    trials = []
    for name in only or COMMANDS:
        text = COMMANDS[name].replace("{films}", "{in}/films/left.mp4 {in}/films/right.mp4")
        trials.append(Trial(name, text.replace("{in}", str(inputs)).split(),
                            (work / name).absolute()))  # fmt: skip

    def run(trial: Trial) -> None:
        disturb(trial, kills, np.random.default_rng([seed, crc32(trial.name.encode())]))
        said = "; ".join(trial.problems) or "no problem"
        log.info("%s: %d faults, %s", trial.name, sum(trial.faults.values()), said)

    with ThreadPoolExecutor(_AT_ONCE) as pool:
        list(pool.map(run, trials))
    missed = [problem for trial in trials for problem in trial.problems]
    result = {t.name: {"faults": t.faults, "problems": len(t.problems)} for t in trials}
    kinds = list(dict.fromkeys(kind for t in trials for kind in t.faults))
    rows = tuple((t.name, *(str(t.faults.get(k, 0)) for k in kinds), str(len(t.problems)))
                 for t in trials)  # fmt: skip
    table = Table("Faults of commands", ("command", *kinds, "problems"), rows)
    return Outcome({"commands": result}, [table], missed)


def disturb(trial: Trial, kills: int, rng: np.random.Generator) -> None:
    """Run one command undisturbed, then under all faults."""
    trial.clear()
    began, run = time.monotonic(), trial.start()
    _, said = run.communicate(timeout=_MOST_S)
    if run.returncode:
        trial.problems.append(f"{trial.name}, undisturbed: {said.strip()[-200:]}")
        return
    trial.seconds, trial.files = time.monotonic() - began, names(trial.folder)
    trial.clear()
    for moment in rng.uniform(0.0, 1.1 * trial.seconds, kills):
        _interrupt(trial, "kill", signal.SIGKILL, float(moment), ())
    trial.finish("kill")
    for fault in (_stale_lock, _stopped, _closed_stdout, _clock, _full_disk, _read_only,
                  _two_writers):  # fmt: skip
        trial.clear()
        fault(trial, rng)


def _interrupt(
    trial: Trial, fault: str, number: int, moment: float, codes: tuple[int, ...],
    times: int = 1, send: Callable[[int, int], None] = os.kill,
) -> str:  # fmt: skip
    """Start, send a signal to the first process after `moment` s, and wait for all of them.

    Several `times` follow at 0.1 s; `send` is os.killpg for what a terminal does.
    """
    run = trial.start()
    with suppress(subprocess.TimeoutExpired):
        run.wait(moment)
    ended = run.poll() is not None
    with suppress(ProcessLookupError):
        for _ in range(times):
            send(run.pid, number)
            time.sleep(0.1 * (times > 1))
    _, said = run.communicate(timeout=_MOST_S)
    for pid in _left(run.pid):
        trial.problems.append(f"{trial.name}, {fault}: process {pid} is left")
        os.kill(pid, signal.SIGKILL)
    trial.check(fault, said, (0,) if ended else codes, run.returncode)
    return said


def _stopped(trial: Trial, rng: np.random.Generator) -> None:
    """SIGTERM, Ctrl-C, Ctrl-C twice; the same command goes on after each."""
    for fault, number, times, send in (
        ("SIGTERM", signal.SIGTERM, 1, os.kill), ("Ctrl-C", signal.SIGINT, 1, os.killpg),
        ("Ctrl-C twice", signal.SIGINT, 2, os.killpg),
    ):  # fmt: skip
        moment = float(rng.uniform(0.3, 0.9)) * trial.seconds
        _interrupt(trial, fault, number, moment, _INTERRUPTED, times, send)
        left = [n for n in names(trial.folder) if n.endswith((".tmp", "lock"))]
        trial.problems += [f"{trial.name}, {fault}: {n} is left" for n in left if times == 1]
    trial.finish("Ctrl-C twice")


def _stale_lock(trial: Trial, _: np.random.Generator) -> None:
    """Killed while it holds the lock of its output: the next one takes the lock over."""
    run = trial.start()
    until = time.monotonic() + trial.seconds
    while not any(trial.folder.rglob(".*lock")) and time.monotonic() < until:
        time.sleep(0.002)
    with suppress(ProcessLookupError):
        os.killpg(run.pid, signal.SIGKILL)
    run.communicate(timeout=_MOST_S)
    if not any(trial.folder.rglob(".*lock")):
        trial.problems.append(f"{trial.name}, stale lock: no lock was taken")
    trial.check("stale lock")
    trial.finish("stale lock")


def _clock(trial: Trial, _: np.random.Generator) -> None:
    """The clock of the day goes back and forth by a day at every reading."""
    run = trial.start([sys.executable, "-c", _JUMPS, *trial.words])
    said = run.communicate(timeout=_MOST_S)[1]
    trial.check("clock jumps", said, (0,), run.returncode)
    trial.compare("clock jumps")


def _closed_stdout(trial: Trial, _: np.random.Generator) -> None:
    run = trial.start()
    assert run.stdout is not None
    run.stdout.close()
    run.stdout = None
    said = run.communicate(timeout=_MOST_S)[1]
    trial.check("closed stdout", said, _CLOSED, run.returncode)
    trial.compare("closed stdout")


def _full_disk(trial: Trial, _: np.random.Generator) -> None:
    """The disk is full from each write on, until the command no longer notices."""
    for number in range(4):
        run = trial.start([sys.executable, "-c", _FULL, str(number), *trial.words])
        said = run.communicate(timeout=_MOST_S)[1]
        trial.check("full disk", said, (0, 1), run.returncode)
        if run.returncode == 0:
            break
        if "disk is full" not in said and "No space left" not in said:
            trial.problems.append(f"{trial.name}, full disk: says {said.strip()[-120:]}")
    else:
        trial.finish("full disk")
    trial.compare("full disk")


def _read_only(trial: Trial, _: np.random.Generator) -> None:
    """The output lies in /sys, where not even root makes a file."""
    words = [w.replace("o/", "/sys/", 1) if w.startswith("o/") else w for w in trial.words]
    run = trial.start([sys.executable, "-m", *words])
    said = run.communicate(timeout=_MOST_S)[1]
    trial.check("read-only folder", said, (1, 2), run.returncode)


def _two_writers(trial: Trial, rng: np.random.Generator) -> None:
    """A second process either is refused in one line or comes after the first."""
    first = trial.start()
    time.sleep(float(rng.uniform(0.2, 0.8)) * trial.seconds)
    second = trial.start()
    ends = [(run.communicate(timeout=_MOST_S)[1], run.returncode) for run in (first, second)]
    for said, code in ends:
        trial.check("two writers", said, (0, 1), code)
    if all(code for _, code in ends):
        trial.problems.append(f"{trial.name}, two writers: neither ended well")
    trial.compare("two writers")


def _left(session: int) -> list[int]:
    """Processes of a session that have not ended after some seconds, but for zombies."""
    until = time.monotonic() + _ENDED_S
    while (found := list(_members(session))) and time.monotonic() < until:
        time.sleep(0.2)
    return found


def _members(session: int) -> Iterator[int]:
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, IndexError, ValueError):
            state, _, _, sid = stat.read_text().rpartition(")")[2].split()[:4]
            if int(sid) == session and state != "Z":
                yield int(stat.parent.name)
