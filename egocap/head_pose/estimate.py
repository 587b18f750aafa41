"""Head poses of a sequence by odometry: pictures followed, the map adjusted, the floor found."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.geometry import transform
from egocap.head_pose.floor import Pictured
from egocap.head_pose.imu import Inertial
from egocap.head_pose.map_poses import MapPoses, joined_parts, overlapping, turned
from egocap.head_pose.pictures import Grey, grey_pictures
from egocap.head_pose.result import HeadTrajectory, gaps_of
from egocap.head_pose.rig_correction import frames_of, search_rig
from egocap.head_pose.vertical import Vertical, find_vertical
from egocap.head_pose.wearer import WearerMasks
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import Finished, finish
from egocap.odometry.loop_closure import close_loops, join_segments
from egocap.odometry.odometry import Odometry
from egocap.odometry.self_calibration import RigSearch
from egocap.odometry.views import Views
from egocap.workers import WorkerPool

log = logging.getLogger(__name__)
FLOOR_FRAMES = 16
LONGEST, OVERLAP = 3000, 90  # frames of a part, and of two together
Advance = Callable[[int], None]


def by_odometry(
    sequence: Sequence, config: OdometryConfig, rig: Rig, track: Track | None, advance: Advance,
    search: RigSearch | None = None,
) -> MapPoses:  # fmt: skip
    """Poses in the map's frame. InputError where no frame has one.

    `search`: for errors of the rig, in place of the one that is made where the settings say so.
    """
    views = Views.of(rig, config.width)
    if search is None and config.self_calibration:
        wearer = None if track is None else WearerMasks(track, views)
        search = search_rig(sequence, views, config, wearer)
    correction = None if search is None else search.correction
    views = views if correction is None else correction.views
    parts, wanted = overlapping(len(sequence), LONGEST, OVERLAP), spread_over(len(sequence))
    if len(parts) == 1:
        found = [_follow(sequence, parts[0], views, config, track, wanted, advance)]
    else:
        job = partial(_follow_part, sequence.folder, views=views, config=config, track=track,
                      wanted=wanted)  # fmt: skip
        found = []
        with WorkerPool(min(len(os.sched_getaffinity(0)), len(parts))) as pool:
            for part, poses in zip(parts, pool.map(job, parts), strict=True):
                found.append(poses)
                advance(part.stop - part.start - (OVERLAP if part.start else 0))
    without = {i: why for poses in found if isinstance(poses, dict) for i, why in poses.items()}
    posed = [poses for poses in found if isinstance(poses, MapPoses)]
    if not posed:
        why = max(sorted(set(without.values())), key=list(without.values()).count)
        raise InputError(f"{sequence.folder}: no head pose in {len(without)} frames: {why}",
                         valid="pictures with texture in two views at once")  # fmt: skip
    whole = joined_parts(posed)
    corrected = {} if correction is None else {"self_calibration": correction.facts()}
    return replace(whole, facts=whole.facts | corrected, reasons=without | whole.reasons,
                   rig_covariance=None if search is None else search.covariance)  # fmt: skip


def _follow_part(folder: Path, part: range, **settings: Any) -> MapPoses | dict[int, str]:
    return _follow(Sequence(folder), part, **settings)


def _follow(
    sequence: Sequence, part: range, views: Views, config: OdometryConfig, track: Track | None,
    wanted: set[int], advance: Advance = lambda frames: None,
) -> MapPoses | dict[int, str]:  # fmt: skip
    """Poses of a part; where none of its frames has one, the reason of each."""
    odometry, reasons = Odometry(views, config), {}
    kept: dict[int, tuple[Grey | None, ...]] = {}
    wearer = None if track is None else WearerMasks(track, views)
    for frame in frames_of(sequence, views.rig, part, wearer):
        pose = odometry.add(*frame)
        if pose.T_world_head is None:
            reasons[frame[0]] = pose.problem
        elif frame[0] in wanted:
            kept[frame[0]] = frame[2]
        advance(1)
    if not odometry.map.frames:
        return reasons
    pictures = partial(grey_pictures, sequence, views.rig)
    joined = join_segments(odometry, pictures)
    loops = close_loops(odometry, pictures)
    found = finish(odometry.map, views)
    facts = _facts(found) | {"joined": joined, "loops": loops}
    pictured = {frame.index: Pictured(kept[frame.index], frame.motion)
                for frame in odometry.map.frames if frame.index in kept}  # fmt: skip
    return MapPoses(found.frame, found.time, found.T_map_head, found.covariance, found.points,
                    views, facts, reasons, pictured)  # fmt: skip


def spread_over(frames: int) -> set[int]:
    """Frames whose pictures are kept for the floor, several times as many as are used of them."""
    return set(np.linspace(0, frames - 1, 4 * FLOOR_FRAMES).astype(int).tolist())


def vertical_of(found: MapPoses, inertial: Vertical | None = None) -> Vertical:
    """Up and the floor's height, from the map's planes, an IMU and some pictures of a width."""
    kept = [row for row, frame in enumerate(found.frame.tolist()) if frame in found.pictures]
    some = np.unique(np.linspace(0, len(kept) - 1, FLOOR_FRAMES).astype(int)) if kept else ()
    rows = [kept[i] for i in some]
    frames = [(found.T_map_head[row], found.pictures[int(found.frame[row])]) for row in rows]
    vertical = find_vertical(found.views, found.points, found.T_map_head, frames, inertial,
                             found.rig_covariance)  # fmt: skip
    if vertical.floor is None:
        log.warning("the floor was not found: heights are relative to the first head")
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


def vertical_facts(vertical: Vertical) -> dict[str, Any]:
    """JSON-ready form."""
    std = None if vertical.floor_std is None else round(1e3 * vertical.floor_std, 2)
    return {"up_from": vertical.source, "up_std_deg": round(float(np.degrees(vertical.up_std)), 3),
            "floor_std_mm": std}  # fmt: skip


def _facts(found: Finished) -> dict[str, Any]:
    """JSON-ready facts of the map: residuals as a multiple of the assumed noise."""
    return {"method": "odometry", "parts": 1, "keyframes": found.keyframes,
            "points": len(found.points), "segments": found.segments,
            "noise_factor": round(found.noise, 3)}  # fmt: skip
