"""The log of looks at the test set: who scored it when, at which commit, and why."""

from __future__ import annotations

import json
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path

from egocap.errors import InputError
from egocap.files import disk_errors
from egocap_eval.harness.result_file import git_commit

FILE = Path(__file__).parents[2] / "test_log.jsonl"


def log_look(reason: str | None, weights: str, path: Path = FILE) -> None:
    """Append a line about a look at the test set.

    Args:
        reason: why it is looked at.
        weights: SHA-256 of the detector's weights.
        path: the log.

    Raises:
        InputError: no reason is given, the code is not a checkout, or its tree is not clean.
    """
    if not (reason or "").strip():
        raise InputError("a look at the test set without --reason", valid="e.g. 'release 0.2'")
    commit = git_commit()
    if commit is None or commit.endswith("+changes"):
        found = "outside a checkout" if commit is None else "with uncommitted changes"
        raise InputError(f"a look at the test set {found}", valid="a clean checkout")
    line = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"), "commit": commit,
        "command": shlex.join(["egocap-eval", *sys.argv[1:]]), "weights": weights,
        "reason": reason,
    }  # fmt: skip
    with disk_errors(path), path.open("a") as file:
        file.write(json.dumps(line) + "\n")
