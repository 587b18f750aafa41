"""Head poses in the world from pictures as they come: an odometry, with up and floor found beside.

Causal: a pose depends on earlier pictures alone, and is not corrected later. There is none until
two searches for up and the floor, a second apart, agree. Where the odometry is lost, there is none
either; the world then goes on from the last known place and heading, so that what the head moved
meanwhile is missing from the path.

What is wrong with the rig file is sought once, from the first pictures that move; the odometry then
begins anew with the corrected rig. Where points fit the file badly, there is no pose before.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.geometry import rigid
from egocap.head_pose.estimate import vertical_facts
from egocap.head_pose.floor import Pictured
from egocap.head_pose.pictures import Grey, grey_of
from egocap.head_pose.rig_correction import Added, OnlineCorrection
from egocap.head_pose.vertical import Vertical, find_vertical
from egocap.odometry.config import OdometryConfig
from egocap.odometry.odometry import HeadPose, Odometry
from egocap.odometry.self_calibration import Correction, find_correction
from egocap.odometry.track_map import Posed
from egocap.odometry.views import Motion, Views

SEARCH_S = 1.0
"""Time between searches for up and the floor."""
PICTURES = 2
"""Frames, spread over the time since the last search, in which the floor is searched."""
SURE = np.deg2rad(0.6)
"""Standard deviation of up, above which a search has failed."""
AGREE_RAD, AGREE_M = np.deg2rad(1.0), 0.04
"""By which up and the floor's height may differ between two searches."""
NO_WORLD = "up and the floor are not found yet"
NOT_FITTING = "the pictures do not fit the rig file, which is not corrected yet"
NOISY = 2.0
"""Residuals of points, in stated standard deviations, of a rig file that does not fit."""
_DRAWN = 320  # width of drawn pictures, px
_FLOOR, _CEILING = -1.6, 1.4  # heights of drawn ones, m
_TIDY = 256  # frames after which the map drops what is not needed

Kept = tuple[Posed, tuple[Grey | None, ...]]


@dataclass
class _Segment:
    """One map of the odometry, and what is known of the world in it."""

    number: int
    first: Float[Array, "4 4"]  # T_map_head where it began
    searched: float  # s, when up was searched last
    onwards: Float[Array, "4 4"]  # where in the world it begins
    pictures: deque[Kept] = field(default_factory=lambda: deque(maxlen=PICTURES))
    before: Vertical | None = None  # what the last search found
    T_world_map: Float[Array, "4 4"] | None = None
    settled: bool = False  # whether up and the floor are found


class OnlineHeadPose:
    """Finds head poses frame by frame. Not to be shared between threads; `close` ends its own.

    With `waits`, searches for up and for the rig's errors are waited for, so that the same pictures
    give the same poses; else they go on beside the next pictures. Raises InputError for a rig of
    one view.
    """

    def __init__(
        self, rig: Rig, config: OdometryConfig = OdometryConfig(), *, waits: bool = False  # noqa: B008
    ) -> None:  # fmt: skip
        self.views, self.config, self.waits = Views.of(rig, config.width), config, waits
        self._odometry = Odometry(self.views, config)
        self._frames = self._placed = self._segments = 0
        self._without: Counter[str] = Counter()
        self._segment: _Segment | None = None
        self._last: Float[Array, "4 4"] | None = None  # T_world_head
        self._vertical: Vertical | None = None
        self._searches = ThreadPoolExecutor(2, thread_name_prefix="search")
        self._search: Future[Vertical | None] | None = None
        self._rig_check = OnlineCorrection(self.views, config, self._searches, waits=waits)
        self._correction: Correction | None = None

    def step(
        self,
        images: Sequence[UInt8[Array, "H W 3"] | None],
        time: float,
        late: Sequence[float] = (),
    ) -> Float[Array, "4 4"] | None:
        """T_world_head at the time [s] of the next RGB pictures; None where it is not known.

        `late`: seconds from that time to when each picture was taken; none: all were at the time.
        The world has z up and the floor at height 0; the first head is above its origin, facing +x.
        """
        sizes = [(camera.width, camera.height) for camera in self.views.cameras]
        grey = tuple(None if image is None else grey_of(image, size)
                     for image, size in zip(images, sizes, strict=True))  # fmt: skip
        frame = self._frames, time, grey, (), np.array(late) if any(late) else None
        found = self._odometry.add(*frame)
        self._frames += 1
        T_world_head, problem = None, found.problem
        if found.T_world_head is not None:
            segment = self._segment_of(found, time)
            fits = self._rig_check.done or self._odometry.noise < NOISY
            problem = NO_WORLD if fits else NOT_FITTING
            if fits:
                self._look_for_up(segment, grey, time)
            if segment.T_world_map is not None:
                T_world_head = self._last = segment.T_world_map @ found.T_world_head
            correction = self._rig_check.add(frame, self._odometry.map.frames[-1])
            if correction is not None:
                self._begin_again(correction, frame, T_world_head)
        if T_world_head is None:
            self._without[problem] += 1
        self._placed += T_world_head is not None
        if self._frames % _TIDY == 0:
            self._odometry.forget()
        return T_world_head

    def warm_up(self) -> None:
        """Find a head once in drawn pictures, so that kernels are compiled or loaded.

        Otherwise a machine's first run stops for seconds after its first pictures.
        """
        views = Views.of(self.views.rig, _DRAWN)
        trial, kept = Odometry(views, self.config), []
        for i in range(6):
            T = rigid(np.eye(3), np.array([0.15 * i, 0.0, 0.0]))
            kept.append((T, Pictured(_drawn(views, T), Motion.none(len(views)))))
            trial.add(i, i / 30.0, kept[-1][1].images)
        _search(views, trial.map.points, np.stack([T for T, _ in kept]), kept[:1])
        find_correction(trial.map, views)

    def facts(self) -> dict[str, Any]:
        """What was found so far, JSON-ready."""
        vertical = {} if self._vertical is None else vertical_facts(self._vertical)
        corrected = {} if self._correction is None else self._correction.facts()
        return {"method": "odometry, causal", "frames": self._frames, "posed": self._placed,
                "without": dict(self._without), "segments": self._segments,
                "vertical": vertical, "self_calibration": corrected}  # fmt: skip

    def close(self) -> None:
        """End the threads of the searches."""
        self._rig_check.close()
        self._searches.shutdown(cancel_futures=True)

    def _segment_of(self, found: HeadPose, time: float) -> _Segment:
        """The segment of a pose; a new one begins without a world."""
        if self._segment is None or self._segment.number != found.segment:
            assert found.T_world_head is not None
            self._search = None
            self._segments += 1
            self._segment = _Segment(found.segment, found.T_world_head, time, self._onwards())
        return self._segment

    def _begin_again(
        self, correction: Correction, frame: Added, T_world_head: Float[Array, "4 4"] | None
    ) -> None:
        """A new map with corrected views, which begins where the old one ends."""
        self._correction, self.views = correction, correction.views
        self._odometry, self._segment = Odometry(self.views, self.config), None
        found = self._odometry.add(*frame)
        if found.T_world_head is not None:
            self._segment_of(found, frame[1]).T_world_map = T_world_head

    def _look_for_up(self, segment: _Segment, grey: tuple[Grey | None, ...], time: float) -> None:
        """Search up and the floor until two searches agree."""
        if segment.settled:
            return
        newest = self._odometry.map.frames[-1]
        if not segment.pictures or newest.time - segment.pictures[-1][0].time > SEARCH_S / PICTURES:
            segment.pictures.append((newest, grey))
        if self._search is None and time - segment.searched >= SEARCH_S:
            segment.searched, self._search = time, self._searches.submit(*self._job(segment))
        if self._search is None or not (self.waits or self._search.done()):
            return
        found, self._search = self._search.result(), None
        if found and segment.before and _agree(found, segment.before, newest.t):
            self._vertical = found
            segment.T_world_map = segment.onwards @ found.transform(segment.first)
            segment.settled = True
            segment.pictures.clear()
        segment.before = found

    def _job(self, segment: _Segment) -> tuple[Any, ...]:
        """The search, with copies of what later pictures change."""
        map = self._odometry.map
        own = [i for i, frame in enumerate(map.frames) if frame.segment == segment.number]
        frames = [map.frames[i] for i in own]
        points = map.points[np.isin(map.patches.host, own)]
        heads = np.stack([rigid(f.R, f.t) for f in frames])
        pictures = [(rigid(f.R, f.t), Pictured(grey, f.motion)) for f, grey in segment.pictures]
        return _search, self.views, points, heads, pictures

    def _onwards(self) -> Float[Array, "4 4"]:
        """Where a segment begins: above the origin, or at the last known place and heading."""
        T = np.eye(4)
        if self._last is not None:
            ahead = self._last[:2, 0] / max(float(np.linalg.norm(self._last[:2, 0])), 1e-9)
            T[:2, :2] = [[ahead[0], -ahead[1]], [ahead[1], ahead[0]]]
            T[:2, 3] = self._last[:2, 3]
        return T


def _drawn(views: Views, T_map_head: Float[Array, "4 4"]) -> tuple[Grey, ...]:
    """Grey pictures between a floor and a ceiling of smooth random texture."""
    waves = np.random.default_rng(0).normal(size=(2, 60)) * np.geomspace(2.0, 30.0, 60)
    found = []
    for camera, T_head_camera in zip(views.cameras, views.rig.T_head_camera, strict=True):
        T = T_map_head @ T_head_camera
        pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
        rays, _ = camera.ray(pixels.astype(float))
        rays = rays @ T[:3, :3].T
        height = np.where(rays[..., 2] > 0.0, _CEILING - T[2, 3], T[2, 3] - _FLOOR)
        reach = np.minimum(height / np.maximum(np.abs(rays[..., 2]), 1e-3), 20.0)
        place = T[:2, 3] + reach[..., None] * rays[..., :2]
        found.append((128.0 + 8.0 * np.cos(place @ waves).sum(-1)).clip(0, 255).astype(np.uint8))
    return tuple(found)


def _search(
    views: Views, points: Float[Array, "P 3"], heads: Float[Array, "T 4 4"],
    pictures: list[tuple[Float[Array, "4 4"], Pictured]],
) -> Vertical | None:  # fmt: skip
    """Up and the floor; None where they are not certain."""
    vertical = find_vertical(views, points, heads, pictures)
    return vertical if vertical.floor is not None and vertical.up_std < SURE else None


def _agree(a: Vertical, b: Vertical, head: Float[Array, "3"]) -> bool:
    """Whether two directions are alike, and the floor's depths under a head."""
    assert a.floor is not None and b.floor is not None  # `_search` gives none without
    apart = float(head @ a.up) - a.floor - float(head @ b.up) + b.floor
    return bool(np.linalg.norm(np.cross(a.up, b.up)) < AGREE_RAD and abs(apart) < AGREE_M)
