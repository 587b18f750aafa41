"""Corrections of a rig's calibration, and when its rows are exposed, from the pictures themselves.

In: the map of an odometry that took a rig as it was given. Out: the same rig with its mounts, focal
lengths and centres corrected, the lag of each view, and the readout time of its rolling shutter.

Keyframes, points and the rig are adjusted together. The corrections have prior standard deviations,
and what pictures cannot tell is kept: the mean pose of the cameras on the head, and how far they
are apart. The rig's geometry, or its timing, stays as given where nothing significant is found.

Source: Triggs et al. 2000, section 6 (the reduced camera system); Hedborg et al. 2012 (rows).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.geometry import exponential
from egocap.odometry.ray_kernel import linearised, turned
from egocap.odometry.rig_kernel import joint_equations
from egocap.odometry.track_map import TrackMap
from egocap.odometry.views import Motion, Views

NOISES_PX = 1.0, 0.3, 0.3
"""Standard deviation of a corner, pixels, with a rig as given, and as corrected once and twice."""
KEYFRAMES, FRAMES = 30, 60
"""From so many keyframes the rig is corrected, or from so many frames where these are fewer: the
head of somebody who sits moves little."""
FEWEST_KEYFRAMES = 3
ALIKE = 9.0
"""Observations that count as one: those of a point, and of neighbours, err together."""
SIGNIFICANT = 4.0
"""Standard deviations of a correction that is believed: there are many, and people who walk by, and
points on weak texture, make errors that are alike."""
LIKELY = 3.0
"""Prior standard deviations within which a correction is believed."""
AGREE, LEAST_AGREE = 0.5, 0.65
"""Standard deviations by which a share of the corners errs with a correction that is believed."""

PARAMETERS = ("rotation x", "rotation y", "rotation z", "x", "y", "z", "focal length",
              "centre u", "centre v", "lag", "readout")  # fmt: skip
PRIOR = np.array([*[np.deg2rad(0.5)] * 3, *[0.003] * 3, 0.005, 2.0, 2.0, 0.005, 0.02])
"""Standard deviations: rad and m in the camera's frame, share, px, s."""
LAG, READOUT = (PARAMETERS.index(name) for name in ("lag", "readout"))
TIMING = np.array([name in ("lag", "readout") for name in PARAMETERS])
_FIXED = 1e-3  # of the prior standard deviation, where a correction is not sought
_STEP = 1e-3 * PRIOR
_ROUNDS, _SMALL_STEP = 12, 1e-2  # at most; of the prior standard deviation, of the last one
_LOSS, _LEAST_NOISE = 3.0, 0.02  # width of the loss, and the noise, in standard deviations
_HELD = 1e12  # information of the first keyframe
_CHI2_MEDIAN = 2.0 * np.log(2.0)  # of 2 degrees of freedom


@dataclass(frozen=True, eq=False)
class Correction:
    """The corrected views; values and standard deviations in the units of `PRIOR`."""

    views: Views
    values: Float[Array, "V 11"]
    std: Float[Array, "V 11"]

    @classmethod
    def of(
        cls, views: Views, values: Float[Array, "V 11"], std: Float[Array, "V 11"]
    ) -> Correction:
        """That of views as they were given."""
        return cls(corrected(views, values), values, std)

    def rig(self, given: Rig) -> Rig:
        """The rig, given at any size of its pictures, with mounts and lenses corrected."""
        values = self.values.copy()
        small = self.views.cameras
        values[:, 7:9] *= [[g.width / s.width, g.height / s.height]
                           for g, s in zip(given.cameras, small, strict=True)]  # fmt: skip
        return corrected(Views(given), values).rig

    def facts(self) -> dict[str, Any]:
        """JSON-ready form of what is used, for each view."""
        found = {}
        for name, value, std in zip(self.views.rig.views, self.values, self.std, strict=True):
            found[name] = {
                "rotation_deg": round(float(np.degrees(np.linalg.norm(value[:3]))), 3),
                "translation_mm": round(float(1e3 * np.linalg.norm(value[3:6])), 2),
                "focal_percent": round(float(100 * value[6]), 3),
                "centre_px": round(float(np.linalg.norm(value[7:9])), 2),
                "lag_ms": round(float(1e3 * value[9]), 2),
                "readout_ms": round(float(1e3 * value[10]), 2),
                "readout_std_ms": round(float(1e3 * std[10]), 2),
            }
        return found


@dataclass(frozen=True, eq=False)
class RigSearch:
    """What is wrong with a rig, None where nothing is; and what remains unknown of it.

    The covariance is of `PARAMETERS`, view by view. It holds what pictures can tell of a rig: the
    mean pose of the cameras and how far they are apart are as good as exact in it.
    """

    correction: Correction | None
    covariance: Float[Array, "Q Q"]

    @classmethod
    def fruitless(cls, views: Views) -> RigSearch:
        """That of pictures that tell nothing."""
        prior = np.tile(PRIOR, len(views))
        return cls(None, np.linalg.inv(np.diag(prior**-2.0) + _kept(views)))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Observations of the points (rows of `numbers`) by keyframes."""

    numbers: Int[Array, "P"]
    frame: Int[Array, "N"]
    point: Int[Array, "N"]
    view: Int[Array, "N"]
    pixel: Float[Array, "N 2"]
    inv_sigma: Float[Array, "N"]
    late: Float[Array, "N"]  # s, of the pictures
    twist: Float[Array, "N 6"]  # of the head


def corrected(views: Views, values: Float[Array, "V 11"]) -> Views:
    """The views with corrections of `PARAMETERS`: rad and m in the camera's frame, share, px, s."""
    mounts = []
    for mount, value in zip(views.rig.mounts, values, strict=True):
        T, camera = mount.T_head_camera.copy(), mount.camera
        T[:3, 3] += T[:3, :3] @ value[3:6]
        T[:3, :3] = T[:3, :3] @ exponential(value[:3])
        (a, b), (c, d) = (1.0 + value[6]) * np.array(camera.affine)
        u, v = camera.centre
        camera = replace(camera, centre=(float(u + value[7]), float(v + value[8])),
                         affine=((float(a), float(b)), (float(c), float(d))))  # fmt: skip
        mounts.append(replace(mount, T_head_camera=T, camera=camera))
    rig = replace(views.rig, mounts=tuple(mounts))
    return Views(rig, tuple(values[:, 9].tolist()), tuple(values[:, 10].tolist()))


def find_correction(found: TrackMap, views: Views, first: Correction | None = None) -> RigSearch:
    """What is significantly wrong with a rig, from a map's longest segment.

    `first`: an earlier correction of the rig, with which the map was made.
    """
    rows, nothing = _frames(found), RigSearch.fruitless(views)
    if not rows:
        return nothing
    found.renew_twists(rows)
    seen = _observations(found, rows)
    state = (np.stack([found.frames[k].R for k in rows]),
             np.stack([found.frames[k].t for k in rows]), found.points[seen.numbers])  # fmt: skip
    start = np.zeros((len(views), len(PARAMETERS))) if first is None else first.values
    sought, unknown = np.ones(len(PARAMETERS), bool), nothing.covariance
    while sought.any():
        values, covariance, agree = _adjusted(views, seen, *state, start * sought, sought)
        std = np.sqrt(np.diag(covariance)).reshape(values.shape)
        unlikely = (np.abs(values) > LIKELY * PRIOR).any()
        if unlikely or (first is None and agree < LEAST_AGREE):
            return nothing
        unknown = covariance if sought.all() else unknown
        sure = np.any(np.abs(values) > SIGNIFICANT * std, axis=0)
        believed = sought & np.where(TIMING, np.any(sure & TIMING), np.any(sure & ~TIMING))
        if np.array_equal(believed, sought):
            return RigSearch(Correction.of(views, values, std), unknown)
        sought = believed
    return RigSearch(None, unknown)


def _adjusted(
    views: Views, seen: _Seen, R: Float[Array, "K 3 3"], t: Float[Array, "K 3"],
    X: Float[Array, "P 3"], values: Float[Array, "V 11"], sought: Bool[Array, "11"],
) -> tuple[Float[Array, "V 11"], Float[Array, "Q Q"], float]:  # fmt: skip
    """The corrections that are sought, their covariance, and the share that agrees."""
    prior = np.tile(np.where(sought, PRIOR, _FIXED * PRIOR), (len(views), 1))
    prior[0, LAG] = _FIXED * PRIOR[LAG]  # lags are behind the first view
    derivatives = _derivatives(views, seen, values)  # corrections are small: the same every round
    system = _system(views, seen, R, t, X, values, derivatives, prior, np.inf)
    for _ in range(_ROUNDS):
        pose, rig, points = system.step()
        R = np.stack([turned(a, w) for a, w in zip(R, pose[:, :3], strict=True)])
        t, X, values = t + pose[:, 3:], X + points, values + rig
        system = _system(views, seen, R, t, X, values, derivatives, prior, system.noise)
        if np.abs(rig / PRIOR).max() < _SMALL_STEP:
            break
    return values * (prior == PRIOR), system.covariance(), system.agree


def _frames(found: TrackMap) -> list[int]:
    """Rows of the frames to adjust, all of the longest segment; none where it hardly moves."""
    if not found.frames:
        return []
    segment, keys = found.longest()
    if len(keys) >= KEYFRAMES:
        return keys
    if len(keys) < FEWEST_KEYFRAMES:
        return []
    own = [row for row, frame in enumerate(found.frames) if frame.segment == segment]
    spread = np.linspace(0, len(own) - 1, FRAMES - len(keys)).astype(int)
    return sorted({*keys, *(own[i] for i in spread)})


def _observations(found: TrackMap, rows: list[int]) -> _Seen:
    """Observations of points that at least three of them fix."""
    own = [found.frames[k].seen for k in rows]
    frame = np.repeat(np.arange(len(own)), [len(s.point) for s in own])
    point = np.concatenate([s.point for s in own])
    kept = np.flatnonzero(np.bincount(point)[point] >= 3)
    numbers, place = np.unique(point[kept], return_inverse=True)
    view, pixel, inv_sigma = (
        np.concatenate([getattr(s, name) for s in own])[kept]
        for name in ("view", "pixel", "inv_sigma")
    )
    twist, late = (np.stack([getattr(found.frames[k].motion, name) for k in rows])
                   for name in ("twist", "late"))  # fmt: skip
    return _Seen(numbers, frame[kept], place, view, pixel, inv_sigma, late[frame[kept], view],
                 twist[frame[kept]])  # fmt: skip


def _sights(
    views: Views, seen: _Seen, values: Float[Array, "V 11"], v: int
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Centres and rays of the observations by view v with corrections."""
    now, rows = corrected(views, values), np.flatnonzero(seen.view == v)
    rays, _ = now.rays(v, seen.pixel[rows])
    delay = seen.late[rows] + now.delay(v, seen.pixel[rows], Motion.none(len(views)))
    return now.sights(seen.view[rows], rays, delay, seen.twist[rows])


def _all_sights(
    views: Views, seen: _Seen, values: Float[Array, "V 11"]
) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """Centres and rays of all observations."""
    o, b = (np.empty((len(seen.frame), 3)) for _ in range(2))
    for v in range(len(views)):
        rows = seen.view == v
        o[rows], b[rows] = _sights(views, seen, values, v)
    return o, b


def _derivatives(
    views: Views, seen: _Seen, values: Float[Array, "V 11"]
) -> tuple[Float[Array, "N 3 Q"], Float[Array, "N 3 Q"]]:
    """Of centres and rays by the corrections (central differences)."""
    do, db = (np.zeros((len(seen.frame), 3, *values.shape)) for _ in range(2))
    for v in range(len(views)):
        rows = seen.view == v
        for i, h in enumerate(_STEP):
            step = np.zeros_like(values)
            step[v, i] = h
            (o0, b0), (o1, b1) = (_sights(views, seen, values + d, v) for d in (-step, step))
            do[rows, :, v, i], db[rows, :, v, i] = (o1 - o0) / (2 * h), (b1 - b0) / (2 * h)
    return do.reshape(*do.shape[:2], -1), db.reshape(*db.shape[:2], -1)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of the poses and the rig, in this order, and of the points."""

    noise: float  # of the residuals, in the assumed standard deviation
    agree: float  # share of the observations
    H: Float[Array, "S S"]
    g: Float[Array, "S"]
    W: Float[Array, "P 3 S"]
    V_inv: Float[Array, "P 3 3"]
    g_point: Float[Array, "P 3"]
    shape: tuple[int, ...]  # of the rig's values

    def reduced(self) -> tuple[Float[Array, "S S"], Float[Array, "S"]]:
        """The equations without the points."""
        flat = self.W.reshape(-1, len(self.g))
        eliminated = (self.V_inv @ self.W).reshape(flat.shape)
        return self.H - flat.T @ eliminated, self.g - eliminated.T @ self.g_point.ravel()

    def step(self) -> tuple[Float[Array, "K 6"], Float[Array, "V 11"], Float[Array, "P 3"]]:
        """Gauss-Newton steps of the poses, the rig and the points."""
        S, g = self.reduced()
        step, first = np.linalg.solve(S, -g), len(g) - int(np.prod(self.shape))
        points = -np.einsum("pij,pj->pi", self.V_inv, self.g_point + self.W @ step)
        return step[:first].reshape(-1, 6), step[first:].reshape(self.shape), points

    def covariance(self) -> Float[Array, "Q Q"]:
        """Of the rig's values."""
        own = int(np.prod(self.shape))
        return np.linalg.inv(self.reduced()[0])[-own:, -own:]


def _system(
    views: Views, seen: _Seen, R: Float[Array, "K 3 3"], t: Float[Array, "K 3"],
    X: Float[Array, "P 3"], values: Float[Array, "V 11"],
    derivatives: tuple[Float[Array, "N 3 Q"], Float[Array, "N 3 Q"]],
    prior: Float[Array, "V 11"], noise: float,
) -> _System:  # fmt: skip
    """The equations at a state, with a loss as wide as the residuals, at most as `noise`."""
    N, K = len(seen.frame), len(R)
    r, J_pose, J_point, J_centre, J_ray = linearised(
        R, t, X, seen.frame, seen.point, *_all_sights(views, seen, values), seen.inv_sigma
    )
    squared = (r**2).sum(1)
    free = 1.0 - 3.0 * len(X) / (2.0 * N)
    measured = float(np.sqrt(np.median(squared) / _CHI2_MEDIAN / max(free, 0.2)))
    noise = max(min(noise, measured), _LEAST_NOISE)
    width2 = (_LOSS * noise) ** 2
    weight = (width2 / (width2 + squared)) ** 2 / (ALIKE * noise**2)
    do, db = derivatives
    J = np.concatenate([J_pose, J_centre @ do + J_ray @ db], axis=2)
    H, g, W, V, g_point = joint_equations(r, J, J_point, weight, seen.frame, seen.point, K, len(X))
    H[np.arange(6), np.arange(6)] += _HELD
    given = np.diag(1.0 / prior.ravel() ** 2) + _kept(views)
    H[6 * K :, 6 * K :] += given
    g[6 * K :] += given @ values.ravel()
    V += 1e-9 * np.trace(V, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-9 * np.eye(3)
    agree = float((squared < AGREE**2).mean())
    return _System(noise, agree, H, g, W, np.linalg.inv(V), g_point, values.shape)


def _kept(views: Views) -> Float[Array, "Q Q"]:
    """Information that keeps what pictures cannot tell: the cameras' mean rotation and place on the
    head, and how far they are apart.
    """
    T = views.rig.T_head_camera
    away = T[:, :3, 3] - T[:, :3, 3].mean(0)
    kept = np.zeros((7, len(views), len(PARAMETERS)))
    for v, R in enumerate(T[:, :3, :3]):
        kept[:3, v, :3] = kept[3:6, v, 3:6] = R / len(views)
        kept[6, v, 3:6] = away[v] @ R / np.linalg.norm(away)
    kept = kept.reshape(7, -1) / (_FIXED * PRIOR[[*range(6), 3], None])
    return kept.T @ kept
