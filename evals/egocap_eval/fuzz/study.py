"""Feed mutated files to every reader: each must read them or raise an error for the user.

A foreign exception, more than 10 s, or more than 1 GB of memory is a failure. The file that failed
is kept in the work folder, and is named with the seed and case of its mutation.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from egocap.commandline import progress
from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap_eval.fuzz.targets import make_target, make_targets
from egocap_eval.fuzz.trials import Counts
from egocap_eval.fuzz.watchdog import Batch, watch
from egocap_eval.harness.study import Outcome

BATCH, WORKERS = 1000, 2  # cases of one process, and processes at once


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
    batches = [
        Batch(name, partial(make_target, sequence, name), _work_folder(folder, name, start),
              range(start, min(start + BATCH, each)), seed)
        for name in names for start in range(0, each, BATCH)
    ]  # fmt: skip
    found: dict[str, list[Counts]] = {name: [] for name in names}
    with progress("fuzz", each * len(names), unit="cases") as advance:
        for batch, counts in watch(batches, WORKERS):
            found[batch.name].append(counts)
            advance(len(batch.cases))
    results = {name: _merged(parts) for name, parts in found.items()}
    missed = [f"{f.target}, seed {f.seed}, case {f.case}: {f.what}"
              for r in results.values() for f in r.failures]  # fmt: skip
    rows = tuple((name, str(r.read), str(r.refused), str(len(r.failures)), str(r.hung),
                  f"{1e3 * r.longest:.0f}", f"{r.peak / 1e6:.0f}")
                 for name, r in results.items())  # fmt: skip
    head = ("format", "read", "refused", "failed", "of these hung", "longest ms", "peak MB")
    result = {"cases": each * len(names), "failed": len(missed), "formats": {
        name: {"read": r.read, "refused": r.refused, "failed": len(r.failures), "hung": r.hung}
        for name, r in results.items()}}  # fmt: skip
    return Outcome(result, [Table("Mutated files", head, rows)], missed)


def _merged(parts: list[Counts]) -> Counts:
    return Counts(
        sum(p.read for p in parts), sum(p.refused for p in parts), sum(p.hung for p in parts),
        tuple(sorted((f for p in parts for f in p.failures), key=lambda f: f.case)),
        max(p.longest for p in parts), max(p.peak for p in parts),
    )  # fmt: skip


def _work_folder(folder: Path, name: str, start: int) -> Path:
    return folder / "work" / f"{name.replace('/', '-')}-{start}"


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
