"""Places seen again: segments joined after a gap, and loops closed, before the last adjustment.

In: the map of an odometry, and the pictures of its keyframes. Out: the same map, in which the
segments that see one place have one frame, and keyframes also observe points of earlier visits.

Two keyframes of different segments are matched by features with a depth. What they propose is
believed only if the pictures of the map's points fit there, in several keyframes.

Source: Lowe 2004 (features, ratio test); Fischler and Bolles 1981 (random samples); Umeyama 1991
(rigid alignment); Mur-Artal and Tardos 2017 (loops).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray as Array

from egocap.geometry import inverse, rigid
from egocap.odometry import stereo
from egocap.odometry.odometry import Image, Odometry, is_wearer
from egocap.odometry.ray_kernel import refine_pose, squared_residuals
from egocap.odometry.track_map import Posed

Pictures = Callable[[int], tuple[Image | None, ...]]
"""Grey pictures of a frame, by its number, in all views."""

SHORTEST = 15
"""Frames of a segment that is joined."""
LOOP_S = 10.0
"""Time after which a point that is seen again closes a loop."""
_SAMPLED, _ENDS = 24, 6  # keyframes of a segment that are compared: over all, and at either end
_FEATURES = 500  # of one
_RATIO = 0.8  # of distances to the nearest and the next descriptor
_SAMPLES, _NEAR = 400, np.deg2rad(1.0)  # of three matches; between a point and its ray
_FEATURE_PX = 1.0  # standard deviation of a feature's place
_PROPOSALS, _CONFIRMED, _TRIED = 3, 3, 8  # keyframes that must confirm a join, of so many
_EVERY = 3  # keyframes from loop to loop
_AROUND_M = 2.0  # between cameras, beyond which a point looks too different


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Features of a keyframe that have a depth."""

    row: int  # of the frame in the map
    points: Float[Array, "n 3"]  # head frame, m
    rays: Float[Array, "n 3"]  # head frame, of view 0
    density: Float[Array, "n"]  # px / rad
    descriptors: Float32[Array, "n 128"]


@dataclass(frozen=True, eq=False)
class Places:
    """Where and when the frames of a map were."""

    segment: Int[Array, "F"]
    time: Float[Array, "F"]  # s
    t: Float[Array, "F 3"]  # m

    @classmethod
    def of(cls, frames: Sequence[Posed]) -> Places:
        return cls(np.array([f.segment for f in frames]), np.array([f.time for f in frames]),
                   np.stack([f.t for f in frames]))  # fmt: skip


Proposal = tuple[int, int, int, Float[Array, "4 4"]]
"""Matches that agree, the rows of keyframes a and b, and b's head in a's head frame."""


def join_segments(odometry: Odometry, pictures: Pictures) -> int:
    """Bring segments that see places of the longest one into its frame; how many were joined."""
    counts = Counter(f.segment for f in odometry.map.frames)
    (base, _), *others = counts.most_common()
    left = [segment for segment, count in others if count >= SHORTEST]
    if not left:
        return 0
    known = {s: _landmarks(odometry, s, pictures) for s in (base, *left)}
    proposals: dict[int, list[Proposal]] = {s: [] for s in left}
    joined = [base]
    while joined and left:
        new = [mark for s in joined for mark in known[s]]
        for s in left:
            proposals[s] += _proposals(odometry, new, known[s])
        joined = [s for s in left if _join(odometry, proposals[s], known[s], pictures)]
        left = [s for s in left if s not in joined]
    return len(proposals) - len(left)


def close_loops(odometry: Odometry, pictures: Pictures) -> int:
    """Observe points of earlier visits in the longest segment's keyframes; how many closed one."""
    frames = odometry.map.frames
    _, keys = odometry.map.longest()
    places, closed = Places.of(frames), 0
    for k in keys[::_EVERY]:
        points = _around(odometry, places, frames[k], frames[k].time - LOOP_S)
        if len(points) < odometry.config.fewest:
            continue
        found = odometry.seen_again(frames[k], points, pictures(frames[k].index))
        if found is not None:
            frames[k].seen = frames[k].seen.joined(found.seen)
            closed += 1
    return closed


def _around(odometry: Odometry, places: Places, pose: Posed, until: float) -> Int[Array, "n"]:
    """Points first seen until a time from near a pose in its segment, which does not see them."""
    near = (places.segment == pose.segment) & (places.time < until)
    near &= np.linalg.norm(places.t - pose.t, axis=1) < _AROUND_M
    return np.setdiff1d(np.flatnonzero(near[odometry.map.patches.host]), pose.seen.point)


def _landmarks(odometry: Odometry, segment: int, pictures: Pictures) -> list[Landmarks]:
    """Landmarks of keyframes spread over a segment, and of those next to its gaps."""
    frames = odometry.map.frames
    keys = [k for k in odometry.map.keyframes if frames[k].segment == segment]
    spread = [keys[int(i)] for i in np.linspace(0, len(keys) - 1, _SAMPLED)]
    sample = sorted({*spread, *keys[:_ENDS], *keys[-_ENDS:]})
    return [_described(odometry, k, pictures(frames[k].index)) for k in sample]


def _described(odometry: Odometry, row: int, images: tuple[Image | None, ...]) -> Landmarks:
    import cv2

    views, other = odometry.views, odometry.views.partners[0][0]
    empty = np.zeros((0, 3))
    none = Landmarks(row, empty, empty, np.zeros(0), np.zeros((0, 128), np.float32))
    if images[0] is None or images[other] is None:
        return none
    mask = np.where(odometry.wearer[0].rejected, 0, views.lens_masks[0]).astype(np.uint8)
    spots, descriptors = cv2.SIFT.create(_FEATURES).detectAndCompute(images[0], mask)
    if descriptors is None:
        return none
    pixels = np.array([spot.pt for spot in spots])
    pair = stereo.match(views, 0, other, images, pixels, odometry.config.noise_px,  # pyright: ignore
                        odometry.map.frames[row].motion)  # fmt: skip
    kept = ~is_wearer(pair.points_head)
    rows = pair.rows[kept]
    rays, _, density, _ = views.rays_and_derivative(0, pixels[rows])
    return Landmarks(row, pair.points_head[kept], rays, density, descriptors[rows])


def _proposals(
    odometry: Odometry, base: Sequence[Landmarks], other: Sequence[Landmarks]
) -> list[Proposal]:
    """How keyframes of the base and of another segment may stand to each other."""
    found = ((*_relative(odometry, a, b), a.row, b.row) for a in base for b in other)
    return [(count, a, b, T) for count, T, a, b in found if count >= odometry.config.fewest]


def _join(
    odometry: Odometry, proposals: Sequence[Proposal], other: Sequence[Landmarks],
    pictures: Pictures,
) -> bool:  # fmt: skip
    """Move a segment into the frame of the base and link them; False where nothing confirms it."""
    frames = odometry.map.frames
    for _, a, b, T_a_b in sorted(proposals, key=lambda proposal: -proposal[0])[:_PROPOSALS]:
        T = _pose(frames[a]) @ T_a_b @ inverse(_pose(frames[b]))
        rows = sorted((mark.row for mark in other), key=lambda row: abs(row - b))[:_TRIED]
        found = _confirmed(odometry, frames[a].segment, rows, T, pictures)
        if len(found) >= min(_CONFIRMED, len(rows)):
            first = next(iter(found))
            T = _pose(found[first]) @ inverse(_pose(frames[first]))
            odometry.map.move(frames[b].segment, T, frames[a].segment)
            for row, pose in found.items():
                frames[row].seen = frames[row].seen.joined(pose.seen)
            return True
    return False


def _confirmed(
    odometry: Odometry, base: int, rows: Sequence[int], T: Float[Array, "4 4"], pictures: Pictures
) -> dict[int, Posed]:
    """Poses of keyframes, moved by T, from points of the base segment in their pictures."""
    places, found = Places.of(odometry.map.frames), {}
    for row in rows:
        own = odometry.map.frames[row]
        moved = T @ _pose(own)
        pose = replace(own, R=moved[:3, :3], t=moved[:3, 3], segment=base)
        points = _around(odometry, places, pose, np.inf)
        seen = odometry.seen_again(pose, points, pictures(own.index))
        if seen is not None:
            found[row] = seen
            T = _pose(seen) @ inverse(_pose(own))  # the next ones begin nearer
    return found


def _relative(odometry: Odometry, a: Landmarks, b: Landmarks) -> tuple[int, Float[Array, "4 4"]]:
    """Matches of two keyframes that agree with one pose of b's head in a's head frame."""
    i, j = _matches(a.descriptors, b.descriptors)
    if len(i) < odometry.config.fewest:
        return 0, np.eye(4)
    X, Y, rays = a.points[i], b.points[j], b.rays[j]
    centre = odometry.views.centres[0]
    triples = np.random.default_rng(0).integers(len(i), size=(_SAMPLES, 3))
    R, t = _rigid(Y[triples], X[triples])
    away = np.einsum("sji,snj->sni", R, X[None] - t[:, None]) - centre
    cosine = np.einsum("sni,ni->sn", away, rays) / np.linalg.norm(away, axis=-1)
    good = cosine > np.cos(_NEAR)
    best = int(good.sum(1).argmax())
    if good[best].sum() < 4:
        return 0, np.eye(4)
    data = (X, np.tile(centre, (len(X), 1)), rays, b.density[j] / _FEATURE_PX)
    near = [part[good[best]] for part in data]
    R1, t1, _ = refine_pose(R[best], t[best], *near, np.array([10.0, 3.0]), 10)  # pyright: ignore
    agree = squared_residuals(R1, t1, *data) < 3.0**2
    return int(agree.sum()), rigid(R1, t1)


def _matches(
    a: Float32[Array, "n 128"], b: Float32[Array, "m 128"]
) -> tuple[Int[Array, "k"], Int[Array, "k"]]:
    """Pairs of descriptors, each the other's nearest by far."""
    import cv2

    if len(a) < 2 or len(b) < 2:
        return np.zeros(0, int), np.zeros(0, int)
    there, back = (cv2.BFMatcher().knnMatch(x, y, k=2) for x, y in ((a, b), (b, a)))
    nearest = {m.queryIdx: m.trainIdx for m, n in back if m.distance < _RATIO * n.distance}
    pairs = [
        (m.queryIdx, m.trainIdx)
        for m, n in there
        if m.distance < _RATIO * n.distance and nearest.get(m.trainIdx) == m.queryIdx
    ]
    return tuple(np.array(pairs, int).reshape(-1, 2).T)  # type: ignore[return-value]


def _rigid(
    source: Float[Array, "S 3 3"], target: Float[Array, "S 3 3"]
) -> tuple[Float[Array, "S 3 3"], Float[Array, "S 3"]]:
    """Rotations and translations that bring sets of points onto others best."""
    p, q = source.mean(1, keepdims=True), target.mean(1, keepdims=True)
    U, _, Vt = np.linalg.svd((target - q).transpose(0, 2, 1) @ (source - p))
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
    R = U @ Vt
    return R, q[:, 0] - np.einsum("sij,sj->si", R, p[:, 0])


def _pose(frame: Posed) -> Float[Array, "4 4"]:
    return rigid(frame.R, frame.t)
