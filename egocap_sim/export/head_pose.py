"""Export of the true head poses, as `egocap track --head-pose` reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from egocap.data.sequence import Sequence
from egocap.files import write_npz
from egocap_sim.export.formats import new_file


def write_head_pose(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write `time` (T,) in seconds and `T_world_head` (T, 4, 4). Raises InputError for its name."""
    new_file(out, ".npz")
    truth = sequence.truth
    write_npz(out, time=truth.time, T_world_head=truth.T_world_head)
    on_frames(len(sequence))
