"""Files that a command needs late, read at its start: a bad one is refused before the work."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

P = TypeVar("P", str, Path)


def check_body(body: str | None) -> None:
    """Raise FileError or InputError unless `body` names proportions, or a fit, for later."""
    from egocap.fitting.wearer import find_body

    if body is not None and body.partition(":")[0] != "fit":
        find_body(_local(body))


def check_head_pose(path: Path | None) -> None:
    """Raise FileError unless it is a file of head poses."""
    from egocap.data.head_pose import load_head_pose

    if path is not None:
        load_head_pose(_local(path))


def check_rig(path: Path | None) -> None:
    """Raise FileError unless it is a rig file."""
    from egocap.cameras.rig_files import load_rig

    if path is not None:
        load_rig(_local(path))


def check_weights(path: Path | None) -> None:
    """Raise FileError unless it holds weights of the detector."""
    from egocap.detect.weights import open_weights

    if path is not None:
        open_weights(_local(path))


def check_checkpoint(path: Path | None) -> None:
    """Raise FileError where it exists and is no chain of the posterior."""
    from egocap.posterior.backend import read_chain

    if path is not None and path.exists():
        read_chain(path)


def _local(path: P) -> P:
    from egocap.storage.copies import here

    return here(path)
