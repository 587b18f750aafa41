"""Corrections of a rig's calibration, and when its rows are exposed, from the pictures themselves.

In: the map of an odometry that took a rig as it was given. Out: the same rig with its mounts, focal
lengths and centres corrected, the lag of each view, and the readout time of its rolling shutter.

Keyframes, points and the rig are adjusted together; the corrections have prior standard deviations,
which also settle what pictures cannot tell: the distance between the cameras and the direction of
the head. Its geometry, or its timing, stays as given where nothing significant is found.

Source: Triggs et al. 2000, section 6 (the reduced camera system); Hedborg et al. 2012 (rows).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.geometry import exponential
from egocap.odometry.ray_kernel import linearised, turned
from egocap.odometry.track_map import TrackMap
from egocap.odometry.views import Views

NOISE_PX = 1.0
"""Standard deviation of a corner, pixels, with a rig that may be wrong."""
KEYFRAMES = 30
"""From so many the rig is corrected."""
FEWEST_KEYFRAMES = 10
SIGNIFICANT = 6.0
"""Standard deviations of a correction that is believed: neighbouring corners err together."""

PARAMETERS = ("rotation x", "rotation y", "rotation z", "x", "y", "z", "focal length",
              "centre u", "centre v", "lag", "readout")  # fmt: skip
PRIOR = np.array([*[np.deg2rad(0.5)] * 3, *[0.003] * 3, 0.005, 2.0, 2.0, 0.005, 0.02])
"""Standard deviations: rad, m, share, px, s."""
LAG = PARAMETERS.index("lag")
TIMING = np.arange(len(PARAMETERS)) >= LAG
_FIXED = 1e-4  # of the prior standard deviation, where a correction is not sought
_STEP = 1e-3 * PRIOR
_ROUNDS = 12
_CHI2_MEDIAN = 2.0 * np.log(2.0)  # of 2 degrees of freedom


@dataclass(frozen=True, eq=False)
class Correction:
    """The corrected views; values and standard deviations in the units of `PRIOR`."""

    views: Views
    values: Float[Array, "V 11"]
    std: Float[Array, "V 11"]

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
class _Seen:
    """Observations of the points (rows of `numbers`) by keyframes."""

    numbers: Int[Array, "P"]
    frame: Int[Array, "N"]
    point: Int[Array, "N"]
    view: Int[Array, "N"]
    pixel: Float[Array, "N 2"]
    inv_sigma: Float[Array, "N"]
    twist: Float[Array, "K 6"]


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


def find_correction(found: TrackMap, views: Views) -> Correction | None:
    """What is significantly wrong with a rig, from the map's longest segment; None: nothing."""
    segment, _ = Counter(f.segment for f in found.frames).most_common(1)[0]
    keys = [k for k in found.keyframes if found.frames[k].segment == segment]
    if len(keys) < FEWEST_KEYFRAMES:
        return None
    found.renew_twists(keys)
    seen = _observations(found, keys)
    poses = np.stack([found.frames[k].R for k in keys]), np.stack([found.frames[k].t for k in keys])
    sought = np.ones(len(PARAMETERS), bool)
    while sought.any():
        values, std = _adjusted(views, seen, *poses, found.points[seen.numbers], sought)
        sure = (np.abs(values) > SIGNIFICANT * std).any(0)
        believed = np.array([sure[kind == TIMING].any() for kind in TIMING]) & sought
        if np.array_equal(believed, sought):
            return Correction(corrected(views, values), values, std)
        sought = believed
    return None


def _adjusted(
    views: Views, seen: _Seen, R: Float[Array, "K 3 3"], t: Float[Array, "K 3"],
    X: Float[Array, "P 3"], sought: Bool[Array, "11"],
) -> tuple[Float[Array, "V 11"], Float[Array, "V 11"]]:  # fmt: skip
    """The corrections that are sought, and their standard deviations."""
    prior = np.tile(np.where(sought, PRIOR, _FIXED * PRIOR), (len(views), 1))
    prior[0, LAG] *= _FIXED  # lags are behind the first view
    values, noise = np.zeros_like(prior), np.inf
    for _ in range(_ROUNDS):
        (pose, rig, points), noise, covariance = _step(views, seen, R, t, X, values, prior, noise)
        R = np.stack([turned(a, w) for a, w in zip(R, pose[:, :3], strict=True)])
        t, X, values = t + pose[:, 3:], X + points, values + rig
        if np.abs(rig / PRIOR).max() < 1e-3:
            break
    return values * (prior == PRIOR), np.sqrt(np.diag(covariance)).reshape(values.shape)  # pyright: ignore


def _observations(found: TrackMap, keys: list[int]) -> _Seen:
    """Observations of points that at least three of them fix."""
    own = [found.frames[k].seen for k in keys]
    frame = np.repeat(np.arange(len(own)), [len(s.point) for s in own])
    point = np.concatenate([s.point for s in own])
    rows = np.flatnonzero(np.bincount(point)[point] >= 3)
    numbers, place = np.unique(point[rows], return_inverse=True)
    view, pixel, inv_sigma = (
        np.concatenate([getattr(s, name) for s in own])[rows]
        for name in ("view", "pixel", "inv_sigma")
    )
    twist = np.stack([found.frames[k].twist for k in keys])
    return _Seen(numbers, frame[rows], place, view, pixel, inv_sigma, twist)


def _sights(
    views: Views, seen: _Seen, values: Float[Array, "V 11"], v: int
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Centres and rays of the observations by view v with corrections."""
    now, rows = corrected(views, values), np.flatnonzero(seen.view == v)
    rays, _ = now.rays(v, seen.pixel[rows])
    delay, twist = now.delay(v, seen.pixel[rows]), seen.twist[seen.frame[rows]]
    turn = exponential(delay[:, None] * twist[:, :3])
    centre = turn @ now.centres[v] + delay[:, None] * twist[:, 3:]
    return centre, np.einsum("nij,nj->ni", turn, rays)


def _step(
    views: Views, seen: _Seen, R: Float[Array, "K 3 3"], t: Float[Array, "K 3"],
    X: Float[Array, "P 3"], values: Float[Array, "V 11"], prior: Float[Array, "V 11"],
    noise: float,
) -> tuple[tuple[Array, Array, Array], float, Float[Array, "S S"]]:  # fmt: skip
    """One Gauss-Newton step of poses, rig and points; the noise before it; the rig's covariance."""
    N, K, count = len(seen.frame), len(R), values.size
    o, b = np.empty((N, 3)), np.empty((N, 3))
    do, db = np.zeros((N, 3, count)), np.zeros((N, 3, count))
    for v in range(len(views)):
        rows = np.flatnonzero(seen.view == v)
        o[rows], b[rows] = _sights(views, seen, values, v)
        for i, h in enumerate(_STEP):
            less, more = values.copy(), values.copy()
            less[v, i], more[v, i] = values[v, i] - h, values[v, i] + h
            (o0, b0), (o1, b1) = (_sights(views, seen, x, v) for x in (less, more))
            column = v * len(PARAMETERS) + i
            do[rows, :, column], db[rows, :, column] = (o1 - o0) / (2 * h), (b1 - b0) / (2 * h)
    r, J_pose, J_point, J_centre, J_ray = linearised(
        R, t, X, seen.frame, seen.point, o, b, seen.inv_sigma
    )
    J_rig = J_centre @ do + J_ray @ db
    squared = (r**2).sum(1)
    free = 1.0 - 3.0 * len(X) / (2.0 * N)
    measured = float(np.sqrt(np.median(squared) / _CHI2_MEDIAN / max(free, 0.2)))
    noise = max(min(noise, measured), 0.02)
    width2 = (3.0 * noise) ** 2
    weight = (width2 / (width2 + squared)) ** 2 / noise**2
    J = np.zeros((N, 2, 6 * K + count))
    J[np.arange(N)[:, None], :, 6 * seen.frame[:, None] + np.arange(6)] = J_pose.transpose(0, 2, 1)
    J[:, :, 6 * K :] = J_rig
    weighted = weight[:, None, None] * J
    H = np.einsum("nai,naj->ij", weighted, J, optimize=True)
    g = np.einsum("nai,na->i", weighted, r)
    H[np.arange(6), np.arange(6)] += 1e12  # the first keyframe is held
    rig = np.arange(6 * K, len(H))
    H[rig, rig] += 1.0 / prior.ravel() ** 2
    g[rig] += values.ravel() / prior.ravel() ** 2
    W, V, gp = np.zeros((len(X), 3, len(H))), np.zeros((len(X), 3, 3)), np.zeros((len(X), 3))
    np.add.at(W, seen.point, J_point.transpose(0, 2, 1) @ weighted)
    scaled = weight[:, None, None] * J_point
    np.add.at(V, seen.point, scaled.transpose(0, 2, 1) @ J_point)
    np.add.at(gp, seen.point, np.einsum("nai,na->ni", scaled, r))
    V += 1e-6 * np.eye(3) * np.trace(V, axis1=1, axis2=2)[:, None, None] + 1e-9 * np.eye(3)
    VW = np.linalg.solve(V, W)
    S = H - np.einsum("pai,paj->ij", W, VW, optimize=True)
    rhs = g - np.einsum("pai,pa->i", VW, gp)
    inverse = np.linalg.inv(S)
    step = -inverse @ rhs
    points = -np.linalg.solve(V, (gp + W @ step)[..., None])[..., 0]
    parts = step[: 6 * K].reshape(K, 6), step[6 * K :].reshape(values.shape), points
    return parts, noise, inverse[6 * K :, 6 * K :]
