"""Head poses from other sources (SLAM, structure from motion, a headset).

A file is an npz with `time` (N,) in seconds, increasing, and `T_world_head` (N, 4, 4): rigid maps
from the head frame to a world frame of the user's choice. Other arrays are ignored.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.track import Track
from egocap.errors import FileError, InputError
from egocap.files import read_npz
from egocap.geometry import rigid, transform

_SLACK = 1.0  # allowed extrapolation, in median steps between poses


def load_head_pose(path: str | Path) -> tuple[Float[Array, "N"], Float[Array, "N 4 4"]]:
    """Read times and poses. FileError names an array that is missing, damaged or not rigid."""
    found = read_npz(Path(path), only=("time", "T_world_head"))
    for name in ("time", "T_world_head"):
        if name not in found:
            raise FileError(path, "missing", key=name)
        if found[name].dtype.kind != "f" or not np.isfinite(found[name]).all():
            raise FileError(path, "not finite numbers", key=name)
    times, poses = found["time"], found["T_world_head"]
    if times.ndim != 1 or len(times) < 1 or (np.diff(times) <= 0).any():
        raise FileError(path, "does not increase", key="time", valid="seconds, increasing")
    if poses.shape != (len(times), 4, 4):
        raise FileError(path, f"has shape {poses.shape}", key="T_world_head",
                        valid=f"({len(times)}, 4, 4)")  # fmt: skip
    R = poses[:, :3, :3]
    bottom = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(poses), 4))
    square = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max()
    if square > 1e-3 or (np.linalg.det(R) < 0).any() or not np.allclose(poses[:, 3], bottom):
        raise FileError(path, "not rigid", key="T_world_head", valid="rotation and translation")
    return times, poses


def interpolate_poses(
    times: Float[Array, "T"], known: Float[Array, "N"], poses: Float[Array, "N 4 4"]
) -> Float[Array, "T 4 4"]:
    """Interpolate poses: spherical linear for rotations, linear for translations.

    Raises InputError where `times` exceed `known` by more than the median step of `known`.
    """
    from scipy.spatial.transform import Rotation, Slerp

    step = float(np.median(np.diff(known))) if len(known) > 1 else 1e-3
    if times[0] < known[0] - _SLACK * step or times[-1] > known[-1] + _SLACK * step:
        raise InputError(
            f"head poses from {known[0]:g} to {known[-1]:g} s",
            valid=f"those from {times[0]:g} to {times[-1]:g} s",
        )
    if len(known) == 1:
        return np.repeat(poses, len(times), axis=0)
    at = np.clip(times, known[0], known[-1])
    turned = Slerp(known, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    moved = np.stack([np.interp(at, known, poses[:, i, 3]) for i in range(3)], -1)
    return rigid(turned, moved)


def in_world(track: Track, path: str | Path) -> Track:
    """Add head poses from a file, and the joints in the world, to a track."""
    T_world_head = interpolate_poses(track.times, *load_head_pose(path))
    joints = transform(T_world_head, track.joints_head)
    return replace(track, T_world_head=T_world_head, joints_world=joints)
