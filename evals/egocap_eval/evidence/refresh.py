"""Measure again what is stale, cheapest first.

Every result is made by its own commands, in processes of their own; a stopped refresh continues,
since finished results are no longer stale. On a Dask cluster each result is one task; the workers
need a checkout of the same commit and return the files.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from egocap.commandline import DONE, MISSED, progress
from egocap.errors import InputError, MachineError
from egocap.evaluation.table import Table
from egocap.files import write_atomically
from egocap.locks import holding
from egocap_eval.evidence.registry import ROOT, Cited, ResultEntry, chosen
from egocap_eval.harness.result_file import git_commit
from egocap_eval.harness.study import Outcome
from egocap_sim.core.version import code_version

RESULTS = "evals/results"


def study(
    results: Positional[tuple[Annotated[str, arg(metavar="RESULT")], ...]] = (),
    /,
    dry_run: bool = False,
    motions: Annotated[Path | None, arg(metavar="DIR")] = None,
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/refresh"),
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None,
) -> Outcome:
    """Measure stale results again, cheapest first; exit code 3 if some remain stale.

    Args:
        results: Names of results in evals/results; all but that of the test set by default.
        dry_run: List the stale results, why, and the estimated minutes; run nothing.
        motions: Folder of the motion clips.
        work: Folder of footage and finished scores, kept between calls.
        cluster: Address of a Dask scheduler, whose workers run a checkout of the same commit.
    """
    if not (ROOT / RESULTS).is_dir():
        raise InputError("this is not a checkout", valid="a checkout of the repository")
    every = [Cited(entry) for entry in chosen(results)]
    stale = sorted((c for c in every if c.stale), key=lambda c: c.minutes)
    failed: dict[str, str] = {}
    if stale and not dry_run:
        require_ready(motions)
        assert motions is not None
        work, motions = footage_folder(from_root(work)), from_root(motions)
        run = _locally if cluster is None else _on_cluster(cluster)
        with holding(work, folder=True):
            failed = run([c.entry for c in stale], work, motions)
    rows = [{"file": c.entry.file, "minutes": round(c.minutes, 1), "why": list(c.stale)}
            for c in stale]  # fmt: skip
    left = [c.entry.file for c in stale if Cited(c.entry).stale]
    total = sum(c.minutes for c in stale)
    cells = [(r["file"], f"{r['minutes']:.0f}", "; ".join(r["why"])) for r in rows]
    table = Table("", ("stale result", "minutes", "why"), (*cells, ("all", f"{total:.0f}", "")))
    missed = [f"{name} is stale{': ' + failed[name] if name in failed else ''}" for name in left]
    return Outcome({"stale": rows, "failed": failed}, [table] if rows else [], missed)


def from_root(path: Path) -> Path:
    """The path as seen from the checkout, where the commands run: results quote it."""
    return Path(os.path.relpath(path, ROOT))


def footage_folder(work: Path) -> Path:
    """The folder in `work` for footage of the simulator as it is now, which refuses any other."""
    return work / code_version().rpartition("+")[2]


def require_ready(motions: Path | None) -> None:
    """Raise InputError without motions, outside a checkout, or with uncommitted changes."""
    if motions is None or not motions.is_dir():
        raise InputError("measuring again needs --motions DIR", valid="a folder of motion clips")
    commit = git_commit()
    if commit is None or commit.endswith("+changes"):
        raise InputError("the checkout has uncommitted changes", valid="a clean checkout")


def make(entry: ResultEntry, work: Path, motions: Path, commit: str) -> dict[str, bytes]:
    """Run the commands of a result; returns the files that they wrote to evals/results.

    Raises MachineError if a command fails or this checkout is of another commit.
    """
    if git_commit() != commit:
        raise MachineError(f"a worker is at {git_commit()}, not at {commit}")
    for words in entry.commands(work, motions):
        done = subprocess.run(_with_python(words), cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
        if done.returncode not in (DONE, MISSED):
            raise MachineError(f"'{' '.join(words[:3])} ...' exited with {done.returncode}")
    written = (ROOT / RESULTS).glob(f"{Path(entry.file).stem}.*")
    return {path.name: path.read_bytes() for path in written}


def _with_python(words: Sequence[str]) -> list[str]:
    """The command line with this interpreter and with patterns of paths replaced by the paths."""
    words = [path for word in words for path in _paths(word)]
    module = {"egocap-eval": "egocap_eval", "egocap-sim": "egocap_sim", "egocap": "egocap"}
    if words[0] in module:
        return [sys.executable, "-m", module[words[0]], *words[1:]]
    assert words[0] == "python", words
    return [sys.executable, *words[1:]]


def _paths(word: str) -> list[str]:
    """The paths that match a pattern in the last part of a path; any other word as it is."""
    path = Path(word)
    return sorted(map(str, path.parent.glob(path.name))) if "*" in path.name else [word]


Run = Callable[[Sequence[ResultEntry], Path, Path], dict[str, str]]


def _locally(todo: Sequence[ResultEntry], work: Path, motions: Path) -> dict[str, str]:
    """Make results one after the other; returns what failed, with the reason."""
    failed = {}
    with progress("results", len(todo), unit="results") as advance:
        for entry in todo:
            try:
                make(entry, work, motions, git_commit() or "")
            except MachineError as error:
                failed[entry.file] = str(error)
            advance()
    return failed


def _on_cluster(address: str) -> Run:
    """The same on the workers of a Dask cluster."""

    def run(todo: Sequence[ResultEntry], work: Path, motions: Path) -> dict[str, str]:
        from distributed import as_completed

        from egocap.execution.cluster import connect

        failed, commit = {}, git_commit() or ""
        with connect(address) as client, progress("results", len(todo), unit="results") as advance:
            asked: dict[Any, str] = {
                client.submit(make, entry, work, motions, commit, pure=False): entry.file
                for entry in todo
            }
            for future in as_completed(asked):
                if future.status == "finished":
                    for name, content in future.result().items():
                        write_atomically(ROOT / RESULTS / name, content)
                else:
                    failed[asked[future]] = str(future.exception())
                advance()
        return failed

    return run
