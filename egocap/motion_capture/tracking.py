"""Tracking of a long recording in overlapping windows, several at once, in memory that is bounded.

The angles of two windows are blended over their overlap.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.head_pose import HeadPoses
from egocap.data.sequence import Sequence, largest_reduction
from egocap.data.track import Track
from egocap.detect.engine import available_cores
from egocap.geometry import transform
from egocap.head_pose.map_poses import overlapping
from egocap.pose.config import TrackerConfig
from egocap.track.consistency import with_consistency
from egocap.track.tracker import Tracker, turned_rig
from egocap.workers import WorkerPool

WINDOW, OVERLAP = 480, 60  # frames


def track_in_windows(
    folder: Path,
    found: Detections,
    body: Proportions,
    config: TrackerConfig,
    on_frames: Callable[[int], None] = lambda count: None,
    heads: HeadPoses | None = None,
    rig: Rig | None = None,
) -> Track:
    """The track of a recorded sequence from its detections and images. Raises as `Tracker`.

    With `heads`, the head poses of its frames, the track is in the world, too. `rig`: in place of
    the sequence's own.
    """
    rig = Sequence(folder).rig if rig is None else rig
    windows = overlapping(len(found.times), WINDOW, OVERLAP)
    jobs = [
        (folder, rig, found[w.start : w.stop], w.start, body, config,
         None if heads is None else heads[w.start : w.stop])
        for w in windows
    ]  # fmt: skip
    if len(jobs) == 1:
        return _track(*jobs[0], on_frames)
    parts = []
    workers = min(available_cores(), len(jobs))
    with WorkerPool(workers) as pool:
        for window, part in zip(
            windows, pool.map(_track_tidily, *zip(*jobs, strict=True)), strict=True
        ):
            parts.append(part)
            on_frames(window.stop - max(window.start, 0) - (OVERLAP if window.start else 0))
    joined = join(windows, parts, body)
    estimated = joined.config["estimated"]
    assert isinstance(estimated, dict)
    return with_consistency(joined, found, turned_rig(rig, estimated), body, config)


def join(windows: list[range], parts: list[Track], body: Proportions) -> Track:
    """One track; within an overlap the angles pass from one window to the next."""
    whole = parts[0]
    for window, part in zip(windows[1:], parts[1:], strict=True):
        shared = len(whole.times) - window.start
        ramp = (np.arange(shared) + 0.5) / shared
        ease = (ramp * ramp * (3.0 - 2.0 * ramp))[:, None]
        blended = (1.0 - ease) * whole.angles[-shared:] + ease * part.angles[:shared]
        until = len(whole.times) - shared // 2
        arrays = {
            name: np.concatenate([getattr(whole, name)[:until], values[until - window.start :]])
            for name, values in part.by_frame.items()
        }
        arrays["angles"] = np.concatenate([whole.angles[:-shared], blended, part.angles[shared:]])
        whole = replace(whole, **arrays)
    seconds = float(np.mean([part.seconds_per_frame for part in parts]))
    joints = forward(body, whole.angles)
    if whole.T_world_head is not None:
        whole = replace(whole, joints_world=transform(whole.T_world_head, joints))
    return replace(
        whole, joints_head=joints, seconds_per_frame=seconds,
        config=whole.config | {"windows": [[w.start, w.stop] for w in windows]},
    )  # fmt: skip


def _track(
    folder: Path, rig: Rig, found: Detections, first: int, body: Proportions, config: TrackerConfig,
    heads: HeadPoses | None, on_frames: Callable[[int], None] = lambda count: None,
) -> Track:  # fmt: skip
    tracker = Tracker(rig, body, config)
    if not (config.colour or config.checks_appearance):
        return tracker.track(found, heads=heads, on_frames=on_frames)
    sequence = Sequence(folder)
    images = cache(lambda row: reduced_images(sequence, first + row, config.colour_size))
    return tracker.track(found, images, heads, on_frames)


def _track_tidily(*job: Any) -> Track:
    """A window of many in one process: what refers to itself in a circle is freed after each."""
    try:
        return _track(*job)
    finally:
        gc.collect()


def reduced_images(sequence: Sequence, frame: int, size: int) -> tuple[UInt8[Array, "S S 3"], ...]:
    """The images of a frame as the colour term reduces them, or nearly; black where one is missing.

    A JPEG is decoded at a fraction of its size, at least four times that asked for.
    """
    import cv2

    found = []
    for view, camera in enumerate(sequence.rig.cameras):
        most = min(camera.width, camera.height) / (4 * size)
        image = sequence.picture(frame, view, largest_reduction(camera, most))
        if image is None:
            found.append(np.zeros((size, size, 3), np.uint8))
            continue
        found.append(np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA)))
    return tuple(found)
