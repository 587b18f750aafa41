"""A trajectory of another program as head poses: with a reference of the same motion, or without.

With a reference (head poses or a track in the world) the clock, the device's axes and place on the
head, and the scale are found; without one they are as given, or as the format says.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.head_pose import SAME_S, beside, interpolate_poses, load_head_pose
from egocap.errors import FileError, InputError
from egocap.geometry import inverse, rigid, unit
from egocap.head_pose.alignment import Alignment, align, aligned
from egocap.head_pose.config import ForeignOptions
from egocap.head_pose.result import HeadTrajectory
from egocap.head_pose.trajectory_files import Trajectory, read_trajectory

MOST_STEP = 0.25  # s between poses of a trajectory without a gap


def foreign_trajectory(
    path: Path, options: ForeignOptions, rig: Rig, times: Float[Array, "T"]
) -> HeadTrajectory:
    """Head poses at the times of the frames that the trajectory covers.

    Raises FileError for a bad file, InputError for a scale or device axes that nothing gives.
    """
    found = read_trajectory(path, options.format)
    if found.form == "colmap":
        found = _of_rig(found, rig, times, path)
    if options.reference is not None:
        return _with_reference(found, options, times, path)
    if found.up is None:
        raise InputError(f"{path}: COLMAP's world has neither scale nor vertical",
                         valid="--reference FILE, head poses of the same motion")  # fmt: skip
    R_device_head = np.eye(3) if found.R_device_head is None else found.R_device_head
    T = level(found.up) @ found.T_world_device @ rigid(R_device_head, np.zeros(3))
    offset = options.time_offset or 0.0
    facts = {"offset_s": offset, "device": "the head" if found.R_device_head is None else
             "x right, y up, z back, at the head's origin"}  # fmt: skip
    return _at_frames(found, found.time + offset, T, times, path, facts)


def level(up: Float[Array, "3"]) -> Float[Array, "4 4"]:
    """T_z_world: the smallest rotation that brings `up` to z."""
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(up, z)
    if np.linalg.norm(axis) < 1e-12:
        return np.diag([1.0, np.sign(up[2]), np.sign(up[2]), 1.0])
    x, old = unit(axis), up
    new = np.stack([x, np.cross(z, x), z], -1)
    return rigid(new @ np.stack([x, np.cross(old, x), old]), np.zeros(3))


def _of_rig(found: Trajectory, rig: Rig, times: Float[Array, "T"], path: Path) -> Trajectory:
    """COLMAP's pictures as poses of the head, from one view of the rig."""
    named = [v for v in rig.views if v in found.view]
    if not named:
        raise FileError(path, f"pictures of {', '.join(sorted(set(found.view))[:4])}",
                        valid=f"of the views {', '.join(rig.views)}")  # fmt: skip
    rows = np.array([v == named[0] for v in found.view])
    number = found.time[rows]
    if number.max() >= len(times) or len(np.unique(number)) < len(number):
        raise FileError(path, f"frame {number.max():.0f} or a frame twice",
                        valid=f"pictures named by frame, 0 to {len(times) - 1}")  # fmt: skip
    frame = number.astype(int)
    T_camera_head = inverse(rig.T_head_camera[rig.views.index(named[0])])
    rotation = rigid(T_camera_head[:3, :3], np.zeros(3))
    return replace(found, time=times[frame], T_world_device=found.T_world_device[rows] @ rotation)


def _with_reference(
    found: Trajectory, options: ForeignOptions, times: Float[Array, "T"], path: Path
) -> HeadTrajectory:
    assert options.reference is not None
    time, known = load_head_pose(options.reference)
    own = found.time + (options.time_offset or 0.0)
    result = align(own, found.T_world_device, time, known, free_scale=found.form == "colmap")
    T = aligned(found.T_world_device, result)
    return _at_frames(found, own + result.offset_s, T, times, path, _facts(result))


def _facts(found: Alignment) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(found.R_device_head).as_rotvec(degrees=True)
    place = None if np.isinf(found.place_std_m) else [round(v, 4) for v in found.t_device_head]
    return {
        "offset_s": round(found.offset_s, 5), "offset_std_s": round(found.offset_std_s, 5),
        "correlation": round(found.correlation, 3), "scale": round(found.scale, 5),
        "device_head_deg": [round(v, 2) for v in turn], "device_head_m": place,
        "residual_mm": round(1e3 * found.residual_m, 2),
        "residual_deg": round(float(np.degrees(found.residual_rad)), 3),
    }  # fmt: skip


def _at_frames(
    found: Trajectory, time: Float[Array, "N"], T: Float[Array, "N 4 4"],
    times: Float[Array, "T"], path: Path, facts: dict[str, Any],
) -> HeadTrajectory:  # fmt: skip
    """Interpolated at the frames between poses near in time; the other frames are gaps."""
    from egocap.head_pose.result import gaps_of

    before, after = beside(times, time)
    step = max(MOST_STEP, 1.5 * float(np.median(np.diff(time))))
    inside = (times >= time[0] - SAME_S) & (times <= time[-1] + SAME_S)
    covered = np.flatnonzero(inside & (time[after] - time[before] <= step))
    if not len(covered):
        raise FileError(path, f"poses from {time[0]:.3f} to {time[-1]:.3f} s",
                        valid=f"some of the frames' times, {times[0]:.3f} to {times[-1]:.3f} s; "
                        "see --time-offset and --reference")  # fmt: skip
    poses = interpolate_poses(times[covered], time, T)
    gaps = gaps_of(len(times), covered, dict.fromkeys(range(len(times)), "not in the trajectory"))
    facts = {"method": found.form, "poses": len(time), **facts}
    return HeadTrajectory(covered, times[covered], poses, gaps, None, facts)
