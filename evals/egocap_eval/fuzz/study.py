"""Feed mutated files to every reader: each must read them or raise an error for the user.

A foreign exception, more than 10 s, or more than 1 GB of memory is a failure. The file that failed
is kept in the work folder.
"""

from __future__ import annotations

import resource
import shutil
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from egocap.commandline import progress
from egocap.errors import EgocapError, InputError
from egocap.evaluation.table import Table
from egocap.workers import WorkerPool
from egocap_eval.fuzz.mutations import mutated
from egocap_eval.fuzz.targets import Target, make_targets
from egocap_eval.harness.study import Outcome

LIMIT_S, LIMIT_BYTES = 10.0, 1 << 30
BATCH = 1000  # cases of one process


@dataclass(frozen=True)
class Failure:
    """A mutated file that was neither read nor refused."""

    target: str
    case: int
    what: str


def study(
    folder: Annotated[Path, arg(metavar="DIR")],
    cases: int = 50_000,
    only: tuple[str, ...] = (),
    seed: int = 0,
) -> Outcome:
    """Feed mutated files to every reader; each must read or refuse them.

    Args:
        folder: Work folder: valid files, and the mutated ones that failed.
        cases: Number of mutated files, over all formats.
        only: Formats to test; default: all.
        seed: Seed of the mutations.
    """
    if cases < 1:
        raise InputError(f"--cases {cases}", valid="1 or more")
    sequence = _recording(folder)
    names = [t.name for t in make_targets(sequence, folder / "valid")]
    if unknown := sorted(set(only) - set(names)):
        raise InputError(f"no format '{unknown[0]}'", valid=names)
    names = [name for name in names if name in only or not only]
    each = -(-cases // len(names))
    jobs = [(name, start, min(BATCH, each - start)) for name in names
            for start in range(0, each, BATCH)]  # fmt: skip
    found: dict[str, list[Any]] = {name: [] for name in names}
    with (
        WorkerPool(2) as pool,
        progress("fuzz", each * len(names), unit="cases") as advance,
    ):
        for name, start, count in jobs:
            found[name].append(pool.submit(_batch, sequence, folder, name, start, count, seed))
        for name, start, count in jobs:
            found[name][start // BATCH].result()
            advance(count)
    results = {name: _merged([f.result() for f in futures]) for name, futures in found.items()}
    missed = [f"{f.target}, case {f.case}: {f.what}" for r in results.values() for f in r.failures]
    rows = tuple((name, str(r.read), str(r.refused), str(len(r.failures)), f"{1e3 * r.longest:.0f}",
                  f"{r.peak / 1e6:.0f}") for name, r in results.items())  # fmt: skip
    head = ("format", "read", "refused", "failed", "longest ms", "peak MB")
    result = {"cases": each * len(names), "failed": len(missed), "formats": {
        name: {"read": r.read, "refused": r.refused, "failed": len(r.failures)}
        for name, r in results.items()}}  # fmt: skip
    return Outcome(result, [Table("Mutated files", head, rows)], missed)


@dataclass
class Counts:
    """What became of the mutated files of one format."""

    read: int = 0
    refused: int = 0
    failures: tuple[Failure, ...] = ()
    longest: float = 0.0  # seconds
    peak: int = 0  # bytes above the process's size before


def _merged(parts: list[Counts]) -> Counts:
    return Counts(
        sum(p.read for p in parts), sum(p.refused for p in parts),
        tuple(f for p in parts for f in p.failures),
        max(p.longest for p in parts), max(p.peak for p in parts),
    )  # fmt: skip


def _recording(folder: Path) -> Path:
    """A recording of three small frames; an earlier one is taken up."""
    from egocap_sim.core.resources import builtin_file
    from egocap_sim.record.recorder import generate
    from egocap_sim.scene.config import Scene, load_scene

    scene = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    scene["frames"], scene["rig"]["size"] = 3, (160, 128)
    scene["record"] |= {"depth": True}
    generate(Scene.model_validate(scene), folder / "recording", workers=0)
    return folder / "recording"


def _batch(sequence: Path, folder: Path, name: str, start: int, count: int, seed: int) -> Counts:
    """Test one format in this process, with a limit on its memory."""
    work = folder / "work" / f"{name.replace('/', '-')}-{start}"
    target = next(t for t in make_targets(sequence, work / "valid") if t.name == name)
    target.load(target.folder or target.file)  # imports and compiles what it needs
    before = _resident()
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + 2 * LIMIT_BYTES, resource.RLIM_INFINITY))
    counts = fuzz(target, work, range(start, start + count), seed)
    counts.peak = max(0, _resident() - before)
    if counts.peak > LIMIT_BYTES:
        counts.failures += (Failure(name, start, f"{counts.peak / 1e9:.1f} GB of memory"),)
    if not counts.failures:
        shutil.rmtree(work)
    return counts


def _resident() -> int:
    """Largest resident size of this process so far, bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


def fuzz(target: Target, work: Path, cases: range, seed: int = 0) -> Counts:
    """Read mutated copies of a target's file in this process; keeps those that fail in `work`."""
    counts, content = Counts(), target.file.read_bytes()
    copy = work / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    if target.folder is not None:
        shutil.copytree(target.folder, copy)
    else:
        copy.mkdir(parents=True)
    file = copy / target.file.relative_to(target.folder or target.file.parent)
    for case in cases:
        file.write_bytes(mutated(content, file.suffix, np.random.default_rng([seed, case])))
        begun, problem = time.perf_counter(), None
        try:
            with _alarm(), warnings.catch_warnings():
                warnings.simplefilter("ignore")
                target.load(copy if target.folder is not None else file)
            counts.read += 1
        except EgocapError:
            counts.refused += 1
        except Exception as error:
            problem = f"{type(error).__name__}: {error!s:.100}"
        counts.longest = max(counts.longest, time.perf_counter() - begun)
        if problem is not None:
            counts.failures += (Failure(target.name, case, problem),)
            shutil.copy(file, work / f"failed-{case}{file.suffix}")
    shutil.rmtree(copy)
    return counts


@contextmanager
def _alarm() -> Iterator[None]:
    """Raise TimeoutError in the block after LIMIT_S seconds."""

    def stop(*_: object) -> None:
        raise TimeoutError(f"more than {LIMIT_S:g} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
