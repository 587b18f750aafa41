"""Points, keyframes and observations of an odometry, in arrays that grow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.odometry.adjustment import Problem
from egocap.odometry.ray_kernel import logarithm
from egocap.odometry.surface_patches import SurfacePatches, appended
from egocap.odometry.views import Motion, Views

_NEAR_S = 0.15  # between frames whose poses tell a velocity


@dataclass(frozen=True, eq=False)
class Observations:
    """Points seen in one frame by all views."""

    point: Int[Array, "n"]
    view: Int[Array, "n"]
    pixel: Float[Array, "n 2"]
    ray: Float[Array, "n 3"]  # head frame, when it was seen
    delay: Float[Array, "n"]  # s, of that after the frame's time
    inv_sigma: Float[Array, "n"]  # 1 / rad

    @classmethod
    def empty(cls) -> Observations:
        none = np.zeros(0, int)
        return cls(none, none, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    def __getitem__(self, rows: Array) -> Observations:
        return Observations(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def joined(self, other: Observations) -> Observations:
        pairs = ((getattr(self, n), getattr(other, n)) for n in self.__dataclass_fields__)
        return Observations(*(np.concatenate(pair) for pair in pairs))


@dataclass
class Posed:
    """A frame whose head pose is known; `segment` numbers the maps it may belong to."""

    index: int
    time: float  # s
    R: Float[Array, "3 3"]
    t: Float[Array, "3"]
    seen: Observations
    keyframe: bool
    segment: int
    information: Float[Array, "6 6"]
    motion: Motion
    noise: float = 1.0  # the residuals' deviation as a multiple of the stated one


def twist_between(before: Posed, after: Posed, R: Float[Array, "3 3"]) -> Float[Array, "6"]:
    """Mean velocity from one frame to another in a head frame, rad/s and m/s."""
    turn, moved = logarithm(before.R.T @ after.R), R.T @ (after.t - before.t)
    return np.concatenate([turn, moved]) / (after.time - before.time)


@dataclass
class TrackMap:
    """Points and posed frames; poses are R_world_head and t [m]."""

    points: Float[Array, "P 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    frames: list[Posed] = field(default_factory=list)
    keyframes: list[int] = field(default_factory=list)  # rows of `frames`
    patches: SurfacePatches = field(default_factory=SurfacePatches.empty)  # a row a point

    def add_points(self, points: Float[Array, "n 3"], patches: SurfacePatches) -> Int[Array, "n"]:
        """Append points; their numbers."""
        first = len(self.points)
        self.points = appended(self.points, points)
        self.patches.extend(patches)
        return np.arange(first, first + len(points))

    def keep_points(self, count: int) -> None:
        """Drop the points added after the first `count`."""
        self.points, self.patches = self.points[:count], self.patches[slice(count)]

    def move(self, segment: int, T: Float[Array, "4 4"], into: int) -> None:
        """Move the frames and points of a segment by T, and make them part of another one."""
        rows = [i for i, frame in enumerate(self.frames) if frame.segment == segment]
        for i in rows:
            frame = self.frames[i]
            frame.R, frame.t = T[:3, :3] @ frame.R, T[:3, :3] @ frame.t + T[:3, 3]
            frame.segment = into
        own = np.isin(self.patches.host, rows)
        self.points[own] = self.points[own] @ T[:3, :3].T + T[:3, 3]
        self.patches.normal[own] = self.patches.normal[own] @ T[:3, :3].T

    def forget(self, keyframes: int, also: Int[Array, "n"]) -> Int[Array, "P"]:
        """Drop all but the last keyframes and the points that these see, or that are in `also`.

        The newest frame stays, and without what they saw the frames around keyframes, which tell
        velocities, and those that hold a point's patch. Returns the points' new numbers, -1 for
        those dropped.
        """
        keys, newest = self.keyframes[-keyframes:], len(self.frames) - 1
        seeing = {*keys, newest}
        seen = [self.frames[i].seen.point for i in seeing]
        points = np.unique(np.concatenate([also, *seen]))
        around = {k + step for k in (*keys, newest) for step in (-1, 0, 1)}
        rows = sorted({*around, *self.patches.host[points].tolist()} & {*range(newest + 1)})
        number, row = np.full(len(self.points), -1), np.full(newest + 1, -1)
        number[points], row[rows] = np.arange(len(points)), np.arange(len(rows))
        for i in rows:
            own = self.frames[i].seen if i in seeing else Observations.empty()
            self.frames[i].seen = replace(own, point=number[own.point])
        self.points, self.patches = self.points[points], self.patches[points]
        self.patches.host = row[self.patches.host]
        self.frames = [self.frames[i] for i in rows]
        self.keyframes = row[keys].tolist()
        return number

    def hosts(self, points: Int[Array, "n"]) -> tuple[Float[Array, "n 3 3"], Float[Array, "n 3"]]:
        """Poses of the keyframes that hold the points' patches."""
        rows, place = np.unique(self.patches.host[points], return_inverse=True)
        poses = [self.frames[i] for i in rows]
        return np.stack([p.R for p in poses])[place], np.stack([p.t for p in poses])[place]

    def longest(self) -> tuple[int, list[int]]:
        """The segment with the most frames, and the rows of its keyframes."""
        segment, _ = Counter(f.segment for f in self.frames).most_common(1)[0]
        return segment, [k for k in self.keyframes if self.frames[k].segment == segment]

    def renew_twists(self, rows: Iterable[int]) -> None:
        """Velocities of frames from the poses before and after them, where there are any."""
        for row in rows:
            own = self.frames[row]
            near = [f for i in (row - 1, row, row + 1) if 0 <= i < len(self.frames)
                    for f in (self.frames[i],) if f.segment == own.segment
                    and abs(f.time - own.time) < _NEAR_S]  # fmt: skip
            if near[0].time < near[-1].time:
                twist = twist_between(near[0], near[-1], own.R)
                own.motion = replace(own.motion, twist=twist)

    def problem(
        self, keyframes: list[int], fixed: Array, views: Views
    ) -> tuple[Problem, Int[Array, "P"]]:
        """The adjustment of these frames (rows), and the numbers of its points.

        Points with fewer than two observations are left out.
        """
        seen = [self.frames[k].seen for k in keyframes]
        point = np.concatenate([s.point for s in seen])
        frame = np.repeat(np.arange(len(seen)), [len(s.point) for s in seen])
        kept = np.bincount(point, minlength=1)[point] >= 2
        order = np.flatnonzero(kept)
        order = order[np.argsort(point[order], kind="stable")]
        numbers, counts = np.unique(point[order], return_counts=True)
        inv_sigma = np.concatenate([s.inv_sigma for s in seen])[order]
        sights = [views.sights(s.view, s.ray, s.delay, self.frames[k].motion.twist)
                  for k, s in zip(keyframes, seen, strict=True)]  # fmt: skip
        origin, ray = (np.concatenate(parts)[order] for parts in zip(*sights, strict=True))
        poses = [self.frames[k] for k in keyframes]
        problem = Problem(
            np.stack([p.R for p in poses]), np.stack([p.t for p in poses]), self.points[numbers],
            np.concatenate([[0], np.cumsum(counts)]), frame[order], origin, ray, inv_sigma,
            np.asarray(fixed),
        )  # fmt: skip
        return problem, numbers
