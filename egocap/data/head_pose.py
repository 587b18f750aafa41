"""Head poses from other sources (SLAM, structure from motion, a headset).

A file is an npz with `time` (N,) in seconds, increasing, and `T_world_head` (N, 4, 4): rigid maps
from the head frame to a world frame with z up, at most `FARTHEST_M` from its origin. If the floor
is at height 0, `floor_std` is the standard deviation of that height, m; `points` (P, 3) are those
of the surroundings, for a viewer. Other arrays are ignored.
Where no pose is near in time, there is a gap: nothing is interpolated, and the motion stays in the
head frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.data.track import Track
from egocap.errors import FileError, InputError
from egocap.files import read_npz, usable
from egocap.geometry import rigid, transform
from egocap.series import interpolate

_UNSURE_M = 10.0  # largest standard deviation of the floor's height
_SLACK = 1.0  # allowed extrapolation, in median steps between poses
GAP_S = 0.2
"""Seconds between poses above which there is a gap, if their median step is not longer."""
SAME_S = 1e-6
"""Seconds by which times of one instant differ in rounding."""
FARTHEST_M = 1e5
"""Largest coordinate of a head, m; exported motions are float32, which there resolves 8 mm."""

Poses = tuple[Float[Array, "N"], Float[Array, "N 4 4"]]


@dataclass(frozen=True, eq=False)
class HeadPoses:
    """The head's pose in the world at the times of some frames."""

    T_world_head: Float[Array, "T 4 4"]  # in gaps: that of the nearest frame with one
    known: Bool[Array, "T"]
    floor_std: float | None = None
    """Standard deviation of the floor's height, which is 0, m; None: the floor is not known."""

    @classmethod
    def of(cls, poses: Sequence[Float[Array, "4 4"] | None]) -> HeadPoses | None:
        """Those of some frames, None where one is not known; None if none is."""
        known = np.array([pose is not None for pose in poses], bool)
        if not known.any():
            return None
        filled = np.array([np.eye(4) if pose is None else pose for pose in poses])
        return cls(filled[_nearest(known)], known)

    def __getitem__(self, frames: slice) -> HeadPoses:
        """Those of some frames."""
        return HeadPoses(self.T_world_head[frames], self.known[frames], self.floor_std)


def load_head_pose(path: str | Path) -> Poses:
    """Read times and poses. FileError names an array that is missing, damaged or not rigid."""
    return _read(path)[0]


def _read(path: str | Path) -> tuple[Poses, float | None]:
    """Times and poses, and the standard deviation of the floor's height where it is stated."""
    found = read_npz(Path(path), only=("time", "T_world_head", "floor_std"))
    for name in ("time", "T_world_head"):
        if name not in found:
            raise FileError(path, "missing", key=name)
        if found[name].dtype.kind != "f" or not usable(found[name]).all():
            raise FileError(path, "not finite numbers, or too large", key=name)
    times, poses = found["time"], found["T_world_head"]
    if times.ndim != 1 or len(times) < 1 or (np.diff(times) <= 0).any():
        raise FileError(path, "does not increase", key="time", valid="seconds, increasing")
    if poses.shape != (len(times), 4, 4):
        raise FileError(path, f"has shape {poses.shape}", key="T_world_head",
                        valid=f"({len(times)}, 4, 4)")  # fmt: skip
    _check_poses(path, poses)
    return (times, poses), _floor_std(path, found.get("floor_std"))


def load_surroundings(path: str | Path) -> Float[Array, "P 3"]:
    """Points of the surroundings in the world, m; none where the file has none. FileError."""
    points = read_npz(Path(path), only=("points",)).get("points", np.zeros((0, 3)))
    if points.dtype.kind != "f" or points.shape != (len(points), 3) or not usable(points).all():
        raise FileError(path, "not points in metres", key="points", valid="(P, 3), finite")
    return points.astype(float)


def _check_poses(path: str | Path, poses: Float[Array, "N 4 4"]) -> None:
    """Raise FileError unless they are rigid and near the origin."""
    R = poses[:, :3, :3]
    bottom = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(poses), 4))
    square = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max()
    if square > 1e-3 or (np.linalg.det(R) < 0).any() or not np.allclose(poses[:, 3], bottom):
        raise FileError(path, "not rigid", key="T_world_head", valid="rotation and translation")
    require_near(path, poses, "T_world_head")


def require_near(path: str | Path, poses: Float[Array, "N 4 4"], key: str | None = None) -> None:
    """Raise FileError for heads farther from the origin than results can state."""
    farthest = float(np.abs(poses[:, :3, 3]).max())
    if not farthest <= FARTHEST_M:
        raise FileError(path, f"a head is {farthest:.3g} m from the origin", key=key,
                        valid=f"up to {FARTHEST_M:,.0f} m; an origin near the motion")  # fmt: skip


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
    moved = interpolate(at, known, poses[:, :3, 3])
    return rigid(turned, moved)


def beside(
    times: Float[Array, "T"], known: Float[Array, "N"]
) -> tuple[Int[Array, "T"], Int[Array, "T"]]:
    """Places in `known` of the poses on either side of times; the same for a pose's own time."""
    before = np.maximum(np.searchsorted(known, times + SAME_S, side="right") - 1, 0)
    after = np.minimum(np.searchsorted(known, times - SAME_S), len(known) - 1)
    return before, after


def head_poses_at(
    times: Float[Array, "T"], known: Float[Array, "N"], poses: Float[Array, "N 4 4"]
) -> HeadPoses:
    """Head poses of frames, and which frames lie in no gap. InputError if all of them do."""
    steps = np.diff(known)
    step = float(np.median(steps)) if len(steps) else 1e-3
    longest = max(GAP_S, (1.0 + _SLACK) * step)
    before, after = beside(times, known)
    distance = np.minimum(np.abs(known[after] - times), np.abs(known[before] - times))
    inside = known[after] - known[before] <= longest
    outside = (times < known[0]) | (times > known[-1])
    there = np.where(outside, distance <= _SLACK * step, inside)
    if not there.any():
        raise InputError(
            f"head poses from {known[0]:g} to {known[-1]:g} s",
            valid=f"those from {times[0]:g} to {times[-1]:g} s",
        )
    found = interpolate_poses(np.clip(times, known[0], known[-1]), known, poses)
    return HeadPoses(found[_nearest(there)], there)


def _nearest(known: Bool[Array, "T"]) -> Int[Array, "T"]:
    """The known frame that is nearest to each frame, itself where it is known."""
    frames = np.flatnonzero(known)
    place = np.interp(np.arange(len(known)), frames, np.arange(len(frames)))
    return frames[np.rint(place).astype(int)]


def read_head_poses(path: str | Path, times: Float[Array, "T"]) -> HeadPoses:
    """The head poses of a file at the times of frames. Raises FileError, or InputError for none."""
    known, floor_std = _read(path)
    return replace(head_poses_at(times, *known), floor_std=floor_std)


def _floor_std(path: str | Path, found: Array | None) -> float | None:
    if found is None:
        return None
    if found.dtype.kind != "f" or found.shape != () or not 0.0 <= float(found) <= _UNSURE_M:
        raise FileError(
            path, "not a number of metres", key="floor_std", valid=f"0 to {_UNSURE_M:g}"
        )
    return float(found)


def in_world(track: Track, poses: HeadPoses) -> Track:
    """Add head poses, and the joints in the world, to a track."""
    T_world_head = poses.T_world_head
    joints = transform(T_world_head, track.joints_head)
    return replace(
        track, T_world_head=T_world_head, joints_world=joints, in_world=poses.known.copy()
    )
