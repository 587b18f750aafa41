"""Head poses of a sequence by odometry: pictures followed, the map adjusted, the floor found."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.head_pose.floor import Vertical, find_floor, upright
from egocap.head_pose.pictures import grey_frames
from egocap.head_pose.result import HeadTrajectory, gaps_of
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import Finished, finish
from egocap.odometry.odometry import Odometry
from egocap.odometry.views import Views

log = logging.getLogger(__name__)
Advance = Callable[[int], None]


def by_odometry(
    sequence: Sequence, config: OdometryConfig, rig: Rig, track: Track | None, advance: Advance
) -> tuple[Finished, dict[int, str]]:
    """Poses in the map's frame, and why other frames have none. InputError where all fail."""
    views = Views.of(rig, config.width)
    wearer = None if track is None else WearerMasks(track, views)
    odometry, reasons = Odometry(views, config), {}
    for index, images in grey_frames(sequence, views.rig, range(len(sequence))):
        time = float(sequence.times[index])
        masks = () if wearer is None else wearer.at(time)
        pose = odometry.add(index, time, images, masks)
        if pose.T_world_head is None:
            reasons[index] = pose.problem
        advance(1)
    if not odometry.map.frames:
        why = max(sorted(set(reasons.values())), key=list(reasons.values()).count)
        raise InputError(f"{sequence.folder}: no head pose in {len(reasons)} frames: {why}",
                         valid="pictures with texture in two views at once")  # fmt: skip
    return finish(odometry.map, views.centres), reasons


def head_trajectory(
    found: Finished, reasons: dict[int, str], frames: int, vertical: Vertical | None
) -> HeadTrajectory:
    """The poses in the world: z up, the floor at 0, the first head above the origin facing +x.

    The vertical is that of the floor's points where None is given, else the head's mean up.
    """
    if vertical is None:
        vertical = find_floor(found.points, found.T_map_head)
    if vertical is None:
        log.warning("no floor found: the vertical is the head's mean up, uncertain by 10 degrees")
        vertical = upright(found.T_map_head)
    T = vertical.transform(found.T_map_head[0])
    gaps = gaps_of(frames, found.frame, reasons)
    return HeadTrajectory(
        found.frame, found.time, T @ found.T_map_head, gaps, turned(found.covariance, T),
        {"method": "odometry", "vertical": vertical_facts(vertical), **map_facts(found)},
    )  # fmt: skip


def turned(covariance: Float[Array, "N 6 6"], T: Float[Array, "4 4"]) -> Float[Array, "N 6 6"]:
    """Covariances with the position in another frame."""
    A = np.eye(6)
    A[3:, 3:] = T[:3, :3]
    return A @ covariance @ A.T


def vertical_facts(vertical: Vertical) -> dict[str, Any]:
    """JSON-ready form."""
    return {"source": vertical.source, "std_deg": round(float(np.degrees(vertical.up_std)), 4),
            "floor_std_mm": None if vertical.floor_std is None else
            round(1e3 * vertical.floor_std, 3), "floor_points": vertical.points}  # fmt: skip


def map_facts(found: Finished) -> dict[str, Any]:
    """JSON-ready facts of the map: residuals as a multiple of the assumed noise."""
    return {"keyframes": found.keyframes, "points": len(found.points),
            "segments": found.segments, "noise_factor": round(found.noise, 3)}  # fmt: skip
