"""A command as a process of its own, with the time and memory that it and its children take."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from egocap.commandline import DONE
from egocap.errors import MachineError

_SHORTEST_S, _LONGEST_S = 0.01, 0.25  # between samples of memory, a tenth of the time so far


class Memory(NamedTuple):
    """Memory that a process holds, MB; shared pages are divided among those that share them."""

    all: float  # PSS
    own: float  # without pages of files, whose share grows when another that maps them ends


@dataclass(frozen=True)
class Spent:
    """What a finished command took."""

    wall_s: float
    cpu_s: float  # user and system, of all its processes
    peak_mb: float  # highest sum over its processes of the memory that each holds (PSS)


def run_egocap(words: Sequence[str]) -> Spent:
    """Run `egocap` with these words. Raises MachineError if it fails."""
    started = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "egocap", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    peak, ended, status = 0.0, 0, 0
    while not ended:
        peak = max(peak, sum(memory_mb(pid).all for pid in family(process.pid)))
        pause = 0.1 * (time.perf_counter() - started)
        time.sleep(min(max(pause, _SHORTEST_S), _LONGEST_S))
        ended, status, usage = os.wait4(process.pid, os.WNOHANG)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.stderr is not None
    if process.returncode != DONE:
        last = process.stderr.read().decode(errors="replace").strip().splitlines()[-1:]
        raise MachineError(f"'egocap {' '.join(words[:3])} ...' exited with "
                           f"{process.returncode}: {''.join(last)}")  # fmt: skip
    cpu = usage.ru_utime + usage.ru_stime
    return Spent(time.perf_counter() - started, cpu, peak)


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    found, new = [], [pid]
    while new:
        found.append(parent := new.pop())
        for file in Path(f"/proc/{parent}/task").glob("*/children"):
            with suppress(OSError):
                new += map(int, file.read_text().split())
    return found


def memory_mb(pid: int) -> Memory:
    """Memory of a process; 0 once it ended."""
    with suppress(OSError):
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()[1:]
        read = {line.split()[0]: int(line.split()[1]) / 1024.0 for line in lines}
        own = read.get("Pss_Anon:", 0.0) + read.get("Pss_Shmem:", 0.0)
        return Memory(read.get("Pss:", 0.0), own)
    return Memory(0.0, 0.0)
