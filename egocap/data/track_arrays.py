"""A track as plain named arrays, for programs that know nothing of this one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egocap.body.labels import LABELS
from egocap.body.skeleton import DOFS
from egocap.data.track import HIDDEN, Track
from egocap.errors import FileError, MachineError


def write_arrays(path: str | Path, track: Track) -> None:
    """Write times, joints, angles and their names as npz, whole or not at all.

    Joints are in metres, in the world where that is known (`frame` says which), angles in radians;
    `hidden` says for every view why it does not see a joint, by `hidden_names`. Raises FileError or
    MachineError where the file cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise FileError(path, "is a folder", valid="the name of a file")
    world = track.joints_world is not None
    arrays = {
        "time": track.times, "joints": track.joints_world if world else track.joints_head,
        "joint_names": np.array(LABELS), "angles": track.angles, "angle_names": np.array(DOFS),
        "frame": np.array("world" if world else "head"),
    }  # fmt: skip
    optional = {
        "confidence": track.confidence, "T_world_head": track.T_world_head, "hidden": track.hidden,
        "hidden_names": None if track.hidden is None else np.array(HIDDEN),
    }  # fmt: skip
    arrays |= {name: value for name, value in optional.items() if value is not None}
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
        part.replace(path)
    except OSError as error:
        raise MachineError(f"cannot write {path}: {error.strerror}") from None
