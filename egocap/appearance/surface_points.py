"""Points on the surface of the body, tracked from picture to picture and held by its limbs.

Colours say where a body may be; tracked points say how it moved, where sleeve, skin and floor are
of one colour, too. A new point lies where a pixel's ray first meets the body, and is fixed to the
joint that carries the Gaussian there. A point that slipped onto the background turns with the rig:
every frame compares the two explanations, and their ratio, summed over the frames, is its weight.
The rig's turn comes from points beside the body.

Source: Lucas & Kanade 1981; Bouguet 2000, "Pyramidal implementation of the Lucas Kanade feature
tracker"; forward-backward check: Kalal et al. 2010; points on a body model: e.g. Gall et al. 2009,
"Motion capture using joint skeleton tracking and surface estimation".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray as Array

from egocap.appearance.surface_kernel import first_hit, points_energy
from egocap.body.gaussians import RADIUS_SIGMAS, GaussianBody
from egocap.body.kinematics import forward_kinematics
from egocap.body.skeleton import DOF_COUNT, JOINTS
from egocap.cameras.rig import Rig
from egocap.image_model.body_kernel import gaussian_centres, make_chain
from egocap.image_model.image_rays import pixel_angle

WIDTH = 320
"""Width in pixels to which pictures are reduced."""
SPACING, SPARSE = 5, 3
"""Pixels between new points on the arms; elsewhere, so many times as far apart."""
BESIDE = 30
"""Pixels between the points beside the body."""
OPAQUE, CLEAR = 0.6, 0.05
"""Opacity above which a pixel shows the body, and below which it shows the background."""
CORE = 0.8
"""Fraction of a Gaussian's radius within which it gets new points: outlines are uncertain."""
RETURN = 0.5
"""Pixels by which a point that is tracked forth and back may miss its start."""
WEIGHT = 0.02
"""Weight of a point: errors of neighbours are correlated."""
SIGMA, SAME = 1.5, 0.5
"""Standard deviation in pixels of a point from its place on the body, and of its motion."""
FAR = 4.0
"""Pixels from its place on the body at which a point is dropped."""
DEPTH = 0.08
"""Metres between a point and the surface that is seen at its pixel at which it is dropped."""
MOST_ODDS, STEP_ODDS, KNOWN_ODDS = 3.0, 1.0, 2.0
"""Log-odds of body against background: the bound, the largest change a frame, and those of points
of the known first pose. A point at the lower bound is dropped."""
FEWEST = 12
"""Points under which no turn of the rig is estimated."""
_ROUNDS = 5
_FLOW = {"winSize": (11, 11), "maxLevel": 2, "minEigThreshold": 1e-4}
_ARMS = ("shoulder", "elbow", "wrist")


@dataclass(frozen=True, eq=False)
class _Points:
    """Points and what the last frame said of them."""

    view: Int[Array, "N"]
    pixel: Float[Array, "N 2"]  # of the reduced picture
    ray: Float[Array, "N 3"]  # unit, head frame
    joint: Int[Array, "N"]  # that carries the point
    offset: Float[Array, "N 3"]  # from the joint, in its frame, metres
    odds: Float[Array, "N"]
    moved: Float[Array, "N 3"]  # change of the ray since the last frame
    off_turn: Float[Array, "N"]  # that change's distance from the background's, in pixels

    def __len__(self) -> int:
        return len(self.view)

    def kept(self, which: Bool[Array, "N"]) -> _Points:
        return _Points(*(getattr(self, f.name)[which] for f in fields(self)))

    def joined(self, other: _Points) -> _Points:
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return _Points(*(np.concatenate(pair) for pair in pairs))


def _no_points() -> _Points:
    none, rows = np.zeros(0), np.zeros((0, 3))
    index = np.zeros(0, np.int64)
    return _Points(index, np.zeros((0, 2)), rows, index, rows, none, rows, none)


class SurfacePoints:
    """Points on a body, from frame to frame. Not to be shared between threads.

    `rig` has the size of the pictures `grey` that points are tracked in, and of those `before`.
    """

    def __init__(self, rig: Rig, body: GaussianBody) -> None:
        camera = rig.cameras[0]
        self.rig = rig.resized(WIDTH, round(WIDTH * camera.height / camera.width))
        self._size = (WIDTH, self.rig.cameras[0].height)
        self._eyes = np.ascontiguousarray(rig.T_head_camera[:, :3, 3])
        self._body, self._chain = body, make_chain(body)
        self._radius = RADIUS_SIGMAS * body.sigma
        self._on_arm = np.array([joint.name.split("_")[-1] in _ARMS for joint in JOINTS])
        self._pixel = pixel_angle(self.rig.cameras[0])  # radians
        self._grid, self._beside = _grid(self._size, SPACING), _grid(self._size, BESIDE)
        views = range(len(rig.mounts))
        self._grid_rays = [self._rays(v, self._grid) for v in views]
        self._beside_rays = [self._rays(v, self._beside) for v in views]
        self._points = _no_points()
        self.before: list[UInt8[Array, "H W"]] = []
        self.grey: list[UInt8[Array, "H W"]] = []
        self._angles = np.zeros(DOF_COUNT)
        self._opacity: Float[Array, "V h w"] | None = None

    def __len__(self) -> int:
        return len(self._points)

    def follow(
        self, images: Sequence[UInt8[Array, "H W 3"]], predicted: Float[Array, "37"]
    ) -> Float[Array, "3 3"] | None:
        """Track the points into the next RGB images, from where a predicted pose has them.

        Returns the turn of the background in the head frame since the last images, None if there
        is none or nothing to tell it from.
        """
        import cv2

        sized = [cv2.resize(i, self._size, interpolation=cv2.INTER_AREA) for i in images]
        self.before, self.grey = self.grey, [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in sized]
        if self._opacity is None:
            return None
        turn = self._turn()
        self._track(predicted, turn)
        return turn

    def _turn(self) -> Float[Array, "3 3"] | None:
        """The rotation between the rays of background points in the last and these pictures."""
        assert self._opacity is not None
        old, new = [], []
        for v, opacity in enumerate(self._opacity):
            rays, inside = self._beside_rays[v]
            start = inside & (self._at(opacity, self._beside) < CLEAR)
            end, found = _flow(self.before[v], self.grey[v], self._beside[start])
            ends, good = self._rays(v, end)
            old.append(rays[start][found & good])
            new.append(ends[found & good])
        a, b = np.concatenate(old), np.concatenate(new)
        return robust_rotation(a, b, self._pixel) if len(a) >= FEWEST else None

    def _track(self, predicted: Float[Array, "37"], turn: Float[Array, "3 3"] | None) -> None:
        points, every = self._points, np.arange(len(self._points))
        if not len(points):
            return
        there = self.rig.project(self._positions(predicted))[0][points.view, every]
        last = self.rig.project(self._positions(self._angles))[0][points.view, every]
        guess = np.nan_to_num(points.pixel + there - last)
        pixel, ray, good = points.pixel.copy(), points.ray.copy(), np.zeros(len(points), bool)
        for v in range(len(self._eyes)):
            mine = np.flatnonzero(points.view == v)
            end, found = _flow(self.before[v], self.grey[v], points.pixel[mine], guess[mine])
            rays, inside = self._rays(v, end)
            pixel[mine], ray[mine], good[mine] = end, rays, found & inside
        moved = ray - points.ray
        off_turn = np.full(len(points), np.inf)
        if turn is not None:
            off_turn = np.linalg.norm(ray - points.ray @ turn.T, axis=1) / self._pixel
        self._points = replace(
            points, pixel=pixel, ray=ray, moved=moved, off_turn=off_turn
        ).kept(good)  # fmt: skip

    def add(
        self, angles: Float[Array, "37"], H: Float[Array, "37 37"], g: Float[Array, "37"]
    ) -> float:
        """Energy of the points' distances from their places; adds gradient and Gauss-Newton matrix.

        Pseudo-Huber of the angle between rays, over `SIGMA`; both triangles are filled.
        """
        points = self._points
        weight = WEIGHT / (1.0 + np.exp(-points.odds))
        energy = points_energy(
            self._chain, angles, self._eyes, points.view, points.joint, points.offset, points.ray,
            weight, SIGMA * self._pixel, H, g,
        )  # fmt: skip
        return float(energy)  # pyright: ignore[reportArgumentType]

    def settle(self, angles: Float[Array, "37"], opacity: Float[Array, "V h w"]) -> None:
        """Judge the points by the pose found for the last images, and add new ones.

        `opacity` is the body's, along the rays of pictures of any size.
        """
        known = self._opacity is None
        if len(self._points):
            self._judge(angles)
        self._angles, self._opacity = angles, opacity
        for v in range(len(self._eyes)):
            self._points = self._points.joined(self._new(v, angles, KNOWN_ODDS if known else 0.0))

    def forget(self, joints: Bool[Array, "17"]) -> None:
        """Drop the points that these joints carry."""
        self._points = self._points.kept(~joints[self._points.joint])

    def _judge(self, angles: Float[Array, "37"]) -> None:
        points = self._points
        eyes = self._eyes[points.view]
        arm, before = self._positions(angles) - eyes, self._positions(self._angles) - eyes
        distance = np.linalg.norm(arm, axis=1)
        place = arm / distance[:, None]
        was = before / np.linalg.norm(before, axis=1)[:, None]
        off_limb = np.linalg.norm(points.moved - (place - was), axis=1) / self._pixel
        change = (np.minimum(points.off_turn, 1e3) ** 2 - off_limb**2) / (2.0 * SAME**2)
        change = np.where(np.isfinite(points.off_turn), change, 0.0)
        odds = points.odds + np.clip(change, -STEP_ODDS, STEP_ODDS)
        odds = np.clip(odds, -MOST_ODDS, MOST_ODDS)
        depth, _ = self._surface(angles, points.view, points.ray)
        off = np.linalg.norm(points.ray - place, axis=1) / self._pixel
        stays = (odds > -MOST_ODDS) & (off < FAR) & (np.abs(depth - distance) < DEPTH)
        self._points = replace(points, odds=odds).kept(stays)

    def _new(self, v: int, angles: Float[Array, "37"], odds: float) -> _Points:
        """New points in the cells of a view's grid that have none."""
        assert self._opacity is not None
        columns = -(-self._size[0] // SPACING)
        cells = (self._grid // SPACING).astype(int)
        held = (self._points.pixel[self._points.view == v] // SPACING).astype(int)
        free = ~np.isin(cells @ [1, columns], held @ [1, columns])
        rays, inside = self._grid_rays[v]
        free &= inside & (self._at(self._opacity[v], self._grid) > OPAQUE)
        pixel, ray, sparse = self._grid[free], rays[free], (cells[free] % SPARSE == 0).all(1)
        view = np.full(len(pixel), v)
        depth, which = self._surface(angles, view, ray, CORE)
        joint = self._chain.carrier[which]
        good = np.isfinite(depth) & (joint >= 0)
        good &= self._on_arm[joint] | sparse
        view, pixel, ray, joint, depth = (x[good] for x in (view, pixel, ray, joint, depth))
        origins, _, R = self._posed(angles)
        away = self._eyes[view] + depth[:, None] * ray - origins[joint]
        offset = np.einsum("nji,nj->ni", R[joint], away)
        zeros = np.zeros((len(view), 3))
        return _Points(
            view, pixel, ray, joint, offset, np.full(len(view), odds), zeros, zeros[:, 0]
        )

    def _rays(
        self, v: int, pixel: Float[Array, "N 2"]
    ) -> tuple[Float[Array, "N 3"], Bool[Array, "N"]]:
        mount = self.rig.mounts[v]
        rays, inside = mount.camera.ray(pixel)
        return rays @ mount.T_head_camera[:3, :3].T, inside

    def _at(self, opacity: Float[Array, "h w"], pixel: Float[Array, "N 2"]) -> Float[Array, "N"]:
        """A small picture's values at pixels of the reduced ones."""
        height, width = opacity.shape
        scale = np.array([width, height]) / np.array(self._size)
        column, row = (pixel * scale).astype(int).T
        return opacity[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]

    def _posed(self, angles: Float[Array, "37"]):
        origins, axes = np.empty((len(JOINTS), 3)), np.empty((DOF_COUNT, 3))
        R = np.empty((len(JOINTS), 3, 3))
        forward_kinematics(self._chain, np.ascontiguousarray(angles, float), origins, axes, R)
        return origins, axes, R

    def _positions(self, angles: Float[Array, "37"]) -> Float[Array, "N 3"]:
        """Places of the points on the body, head frame, metres."""
        origins, _, R = self._posed(angles)
        joint = self._points.joint
        return origins[joint] + np.einsum("nij,nj->ni", R[joint], self._points.offset)

    def _surface(
        self, angles: Float[Array, "37"], view: Int[Array, "N"], ray: Float[Array, "N 3"],
        core: float = 1.0,
    ) -> tuple[Float[Array, "N"], Int[Array, "N"]]:  # fmt: skip
        """Distance at which rays first meet a Gaussian's radius, inf without, and which it is."""
        centres = gaussian_centres(angles[None], self._body)[0]
        depth, which = np.empty(len(view)), np.empty(len(view), np.int64)
        first_hit(self._eyes, centres, self._radius, core, view, ray, depth, which)
        return depth, which


def robust_rotation(
    a: Float[Array, "N 3"], b: Float[Array, "N 3"], sigma: float
) -> Float[Array, "3 3"]:
    """The rotation R of b = R a for most of some unit vectors.

    Kabsch, reweighted by Cauchy's weights at `sigma` radians.  Source: Holland & Welsch 1977.
    """
    weight, R = np.ones(len(a)), np.eye(3)
    for _ in range(_ROUNDS):
        U, _, Vt = np.linalg.svd((weight[:, None] * b).T @ a)
        R = U @ np.diag((1.0, 1.0, np.linalg.det(U @ Vt))) @ Vt
        weight = 1.0 / (1.0 + (((b - a @ R.T) / sigma) ** 2).sum(1))
    return R


def _grid(size: tuple[int, int], spacing: int) -> Float[Array, "N 2"]:
    """Pixels in the middle of the square cells of a picture."""
    across, down = (np.arange(spacing // 2, length, spacing) for length in size)
    return np.stack(np.meshgrid(across, down), -1).reshape(-1, 2).astype(float)


def _flow(
    before: UInt8[Array, "H W"], after: UInt8[Array, "H W"], start: Float[Array, "N 2"],
    guess: Float[Array, "N 2"] | None = None,
) -> tuple[Float[Array, "N 2"], Bool[Array, "N"]]:  # fmt: skip
    """Where pixels went, from a guess if there is one, and which of them are found.

    Where there is a guess, they must be found again on the way back.
    """
    import cv2

    if not len(start):
        return start, np.zeros(0, bool)
    first = start.astype(np.float32)[:, None]
    if guess is None:
        end, found, _ = cv2.calcOpticalFlowPyrLK(before, after, first, None, **_FLOW)  # pyright: ignore[reportCallIssue, reportArgumentType]
        return end[:, 0].astype(float), found[:, 0] > 0
    end, there = _flow_from(before, after, first, guess.astype(np.float32)[:, None])
    back, again = _flow_from(after, before, end, first)
    close = np.linalg.norm((back - first)[:, 0], axis=1) < RETURN
    return end[:, 0].astype(float), there & again & close


def _flow_from(
    before: UInt8[Array, "H W"], after: UInt8[Array, "H W"], start: Float32[Array, "N 1 2"],
    guess: Float32[Array, "N 1 2"],
) -> tuple[Float32[Array, "N 1 2"], Bool[Array, "N"]]:  # fmt: skip
    import cv2

    end, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, start, guess.copy(), flags=cv2.OPTFLOW_USE_INITIAL_FLOW, **_FLOW
    )  # pyright: ignore[reportCallIssue]
    return end, found[:, 0] > 0
