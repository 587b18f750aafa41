"""Projections of other programs' camera models, in closed form, for any ray they are defined for.

Each model is a plane (a ray's point on a normalised plane) and a distortion of that plane; the
camera matrix follows. Points are (N, 3) in the camera frame, of any length; results are (N, 2) and
validity (N,).

Source: pinhole and Brown-Conrady: OpenCV's calib3d. Mei & Rives 2007 (omni, cv2.omnidir).
Khomutenko et al. 2016 (EUCM). Usenko et al. 2018 (double sphere). Devernay & Faugeras 2001 (FOV).
Engel et al. 2023, "Project Aria" (fisheye624: equidistant with six radial, two tangential and four
thin-prism terms).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

Points = Float[Array, "N 2"]
Plane = Callable[[Float[Array, "N 3"]], tuple[Points, Bool[Array, "N"]]]
Distortion = Callable[[Points], Points]
_FAR = 1e-9


def projection(
    plane: Plane, distortion: Distortion, focal: Sequence[float], centre: Sequence[float],
    skew: float = 0.0,
) -> Plane:  # fmt: skip
    """Rays to pixels: plane, distortion, camera matrix."""
    K = np.array([[focal[0], skew], [0.0, focal[1]]])

    def project(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
        points, valid = plane(rays)
        with np.errstate(over="ignore", invalid="ignore"):
            pixels = distortion(points) @ K.T + np.asarray(centre)
        return pixels, valid & np.isfinite(pixels).all(-1)

    return project


def pinhole(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
    """x / z, y / z before the camera."""
    return _divided(rays, rays[:, 2])


def equidistant(coefficients: Sequence[float] = ()) -> Plane:
    """theta (1 + k1 theta^2 + k2 theta^4 + ...) along the ray's direction, at any angle."""

    def plane(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
        rho = np.hypot(rays[:, 0], rays[:, 1])
        theta = np.arctan2(rho, rays[:, 2])
        radius = theta * np.polynomial.polynomial.polyval(theta**2, [1.0, *coefficients])
        return rays[:, :2] * (radius / np.maximum(rho, _FAR))[:, None], np.ones(len(rays), bool)

    return plane


def mei(xi: float) -> Plane:
    """Onto the unit sphere, then from a point `xi` behind its centre."""
    least = -xi if xi <= 1.0 else -1.0 / xi

    def plane(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
        unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        points, valid = _divided(unit, unit[:, 2] + xi)
        return points, valid & (unit[:, 2] > least)

    return plane


def extended_unified(alpha: float, beta: float) -> Plane:
    """EUCM: onto an ellipsoid, then a plane."""

    def plane(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
        x, y, z = rays.T
        d = np.sqrt(beta * (x * x + y * y) + z * z)
        points, valid = _divided(rays, alpha * d + (1.0 - alpha) * z)
        return points, valid & (z > -_bound(alpha) * d)

    return plane


def double_sphere(xi: float, alpha: float) -> Plane:
    """Onto two unit spheres, one after the other, then a plane."""

    def plane(rays: Float[Array, "N 3"]) -> tuple[Points, Bool[Array, "N"]]:
        x, y, z = rays.T
        first = np.linalg.norm(rays, axis=1)
        shifted = xi * first + z
        second = np.sqrt(x * x + y * y + shifted**2)
        points, valid = _divided(rays, alpha * second + (1.0 - alpha) * shifted)
        w = _bound(alpha)
        return points, valid & (z > -(w + xi) / np.sqrt(2.0 * w * xi + xi * xi + 1.0) * first)

    return plane


def undistorted(points: Points) -> Points:
    """No distortion."""
    return points


def brown_conrady(coefficients: Sequence[float]) -> Distortion:
    """k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4]]], OpenCV's order: k4 to k6 divide."""
    k1, k2, p1, p2, k3, k4, k5, k6, *prism = (*coefficients, *(12 - len(coefficients)) * [0.0])

    def distort(points: Points) -> Points:
        r2 = (points**2).sum(1, keepdims=True)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            up = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            scale = up / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return points * scale + decentred(points, (p2, p1), (prism[0], prism[2]), prism[1::2])

    return distort


def radial_prism(
    radial: Sequence[float], tangential: Sequence[float], first: Sequence[float],
    second: Sequence[float] = (0.0, 0.0),
) -> Distortion:  # fmt: skip
    """Radial terms of r^2, r^4, ..., then `decentred`."""

    def distort(points: Points) -> Points:
        r2 = (points**2).sum(1, keepdims=True)
        scale = np.polynomial.polynomial.polyval(r2, [1.0, *radial])
        return points * scale + decentred(points, tangential, first, second)

    return distort


def decentred(
    points: Points, tangential: Sequence[float], first: Sequence[float], second: Sequence[float]
) -> Points:
    """Tangential (along x, along y) and thin-prism shifts (x, y of r^2 and of r^4)."""
    t = np.asarray(tangential)
    r2 = (points**2).sum(1, keepdims=True)
    along = (points @ t)[:, None]
    return 2.0 * along * points + r2 * t + r2 * np.asarray(first) + r2 * r2 * np.asarray(second)


def field_of_view(omega: float) -> Distortion:
    """atan(2 r tan(omega / 2)) / omega."""

    def distort(points: Points) -> Points:
        r = np.maximum(np.linalg.norm(points, axis=1, keepdims=True), _FAR)
        return points * np.arctan(2.0 * r * np.tan(omega / 2.0)) / (omega * r)

    return distort


def _bound(alpha: float) -> float:
    return alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha


def _divided(
    rays: Float[Array, "N 3"], depth: Float[Array, "N"]
) -> tuple[Points, Bool[Array, "N"]]:
    valid = depth > _FAR
    return rays[:, :2] / np.where(valid, depth, 1.0)[:, None], valid
