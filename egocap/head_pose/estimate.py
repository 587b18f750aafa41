"""Head poses of a sequence by odometry: pictures followed, the map adjusted, the floor found."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import transform
from egocap.head_pose.floor import find_floor
from egocap.head_pose.imu import Inertial
from egocap.head_pose.pictures import Grey, grey_pictures
from egocap.head_pose.result import HeadTrajectory, gaps_of
from egocap.head_pose.rig_correction import find_rig_correction, frames_of
from egocap.head_pose.vertical import Vertical, find_vertical
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import Finished, finish
from egocap.odometry.loop_closure import close_loops, join_segments
from egocap.odometry.odometry import Odometry
from egocap.odometry.self_calibration import Correction
from egocap.odometry.views import Views

log = logging.getLogger(__name__)
FLOOR_FRAMES = 16
Advance = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class MapPoses:
    """Poses of the frames that have one, in the frame of a map of points, metres."""

    frame: Int[Array, "N"]  # numbers of the sequence
    time: Float[Array, "N"]  # s
    T_map_head: Float[Array, "N 4 4"]
    covariance: Float[Array, "N 6 6"] | None  # of rotation (head frame) and position
    points: Float[Array, "P 3"]
    views: Views  # in which the pictures were seen
    facts: dict[str, Any]  # how they were found, JSON-ready
    reasons: dict[int, str]  # why another frame has none
    pictures: dict[int, tuple[Grey | None, ...]]  # of some frames spread over the sequence, grey


def by_odometry(
    sequence: Sequence, config: OdometryConfig, rig: Rig, track: Track | None, advance: Advance,
    correction: Correction | None = None,
) -> MapPoses:  # fmt: skip
    """Poses in the map's frame. InputError where no frame has one.

    `correction`: of the rig, in place of the one that is sought where the settings say so.
    """
    views = Views.of(rig, config.width)
    wearer = None if track is None else WearerMasks(track, views)
    if correction is None and config.self_calibration:
        correction = find_rig_correction(sequence, views, config, wearer)
    views = views if correction is None else correction.views
    odometry, reasons = Odometry(views, config), {}
    kept: dict[int, tuple[Grey | None, ...]] = {}
    wanted = spread_over(len(sequence))
    for frame in frames_of(sequence, views.rig, range(len(sequence)), wearer):
        pose = odometry.add(*frame)
        if pose.T_world_head is None:
            reasons[frame[0]] = pose.problem
        elif frame[0] in wanted:
            kept[frame[0]] = frame[2]
        advance(1)
    if not odometry.map.frames:
        why = max(sorted(set(reasons.values())), key=list(reasons.values()).count)
        raise InputError(f"{sequence.folder}: no head pose in {len(reasons)} frames: {why}",
                         valid="pictures with texture in two views at once")  # fmt: skip
    pictures = partial(grey_pictures, sequence, views.rig)
    joined = join_segments(odometry, pictures)
    loops = close_loops(odometry, pictures)
    found = finish(odometry.map, views)
    facts = _facts(found) | {"joined": joined, "loops": loops}
    if correction is not None:
        facts["self_calibration"] = correction.facts()
    return MapPoses(found.frame, found.time, found.T_map_head, found.covariance, found.points,
                    views, facts, reasons, kept)  # fmt: skip


def spread_over(frames: int) -> set[int]:
    """Frames whose pictures are kept for the floor, several times as many as are used of them."""
    return set(np.linspace(0, frames - 1, 4 * FLOOR_FRAMES).astype(int).tolist())


def vertical_of(found: MapPoses, inertial: Vertical | None = None) -> Vertical:
    """Up and the floor's height, from the map's planes, an IMU and some pictures of a width."""
    vertical = find_vertical(found.points, found.T_map_head)
    if inertial is not None and inertial.up_std < vertical.up_std:
        vertical = inertial
    kept = [row for row, frame in enumerate(found.frame.tolist()) if frame in found.pictures]
    some = np.unique(np.linspace(0, len(kept) - 1, FLOOR_FRAMES).astype(int)) if kept else ()
    rows = [kept[i] for i in some]
    frames = [(found.T_map_head[row], found.pictures[int(found.frame[row])]) for row in rows]
    floor = find_floor(found.views, frames, vertical.up)
    if floor is None:
        log.warning("the floor was not found: heights are relative to the first head")
    else:
        vertical = vertical.with_floor(floor)
    if vertical.source == "head":
        log.warning("no walls, floor or tables found: up is that of the head, uncertain by 10 "
                    "degrees")  # fmt: skip
    return vertical


def head_trajectory(
    found: MapPoses, frames: int, vertical: Vertical, inertial: Inertial | None = None
) -> HeadTrajectory:
    """The poses in the world: z up, the floor at 0, the first head above the origin facing +x."""
    T = vertical.transform(found.T_map_head[0])
    gaps = gaps_of(frames, found.frame, found.reasons)
    covariance = None if found.covariance is None else turned(found.covariance, T)
    return HeadTrajectory(
        found.frame, found.time, T @ found.T_map_head, gaps, covariance,
        {**found.facts, "vertical": vertical_facts(vertical),
         **({} if inertial is None else {"imu": inertial.facts()})},
        vertical.floor_std, transform(T, found.points[np.isfinite(found.points).all(1)]),
    )  # fmt: skip


def turned(covariance: Float[Array, "N 6 6"], T: Float[Array, "4 4"]) -> Float[Array, "N 6 6"]:
    """Covariances with the position in another frame."""
    A = np.eye(6)
    A[3:, 3:] = T[:3, :3]
    return A @ covariance @ A.T


def vertical_facts(vertical: Vertical) -> dict[str, Any]:
    """JSON-ready form."""
    std = None if vertical.floor_std is None else round(1e3 * vertical.floor_std, 2)
    return {"up_from": vertical.source, "up_std_deg": round(float(np.degrees(vertical.up_std)), 3),
            "floor_std_mm": std}  # fmt: skip


def _facts(found: Finished) -> dict[str, Any]:
    """JSON-ready facts of the map: residuals as a multiple of the assumed noise."""
    return {"method": "odometry", "keyframes": found.keyframes, "points": len(found.points),
            "segments": found.segments, "noise_factor": round(found.noise, 3)}  # fmt: skip
