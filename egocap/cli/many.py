"""What detect, track and mocap have in common over several recordings."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egocap.commandline import DONE, FAILED, MISSED
from egocap.errors import InputError

if TYPE_CHECKING:
    from egocap.execution.recording_task import Report
    from egocap.execution.recordings import Recording

Several = tuple[int | None, str | None]
"""--workers and --cluster."""


def are_several(given: Sequence[object], several: Several) -> bool:
    """Whether --out is a folder of results. Raises InputError where nothing is given."""
    if not given:
        raise InputError("no recording given", valid="one or more")
    return len(given) > 1 or several != (None, None)


def run_several(
    command: str, function: Callable[..., Report], settings: dict[str, Any],
    recordings: Sequence[Recording], out: Path, several: Several, *, strict: bool, as_json: bool,
) -> int:  # fmt: skip
    """Run a command for recordings and print the reports; errors as one line each on stderr.

    Returns FAILED if a recording failed, or MISSED if one missed a threshold with `strict`.
    """
    from egocap.execution.choice import choose_executor
    from egocap.execution.recording_run import run_recordings

    workers, cluster = several
    executor = choose_executor(workers or 0, cluster)
    found = run_recordings(command, function, settings, recordings, out, executor)
    for name, error in found.errors.items():
        print(f"egocap: {out / name}: {error}", file=sys.stderr)
    if as_json:
        print(json.dumps({"folder": str(out), "already_complete": found.before,
                          "recordings": {n: r.summary for n, r in found.reports.items()},
                          "failed": found.errors}, indent=1))  # fmt: skip
    else:
        for name, report in found.reports.items():
            print(_text(out / name, report))
        print(f"{out}: {len(found.reports)} of {len(recordings)} recordings"
              f"{f', {found.before} of them already complete' * bool(found.before)}")  # fmt: skip
    if found.errors:
        return FAILED
    return MISSED if strict and any(r.missed for r in found.reports.values()) else DONE


def print_report(kind: str, path: Path, report: Report, as_json: bool) -> None:
    """What is said of a single recording; `kind` is the key of the path in JSON."""
    summary = {kind: str(path)} | report.summary
    print(json.dumps(summary, indent=1) if as_json else _text(path, report))


def _text(path: Path, report: Report) -> str:
    return f"{path}: " + "\n".join(report.lines)
