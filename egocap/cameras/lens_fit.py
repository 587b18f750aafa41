"""A Kannala-Brandt camera nearest to any projection, with the error in pixels that is left.

Other programs' models have terms that are not radial (tangential, thin prism) or other radial
functions; files of theirs are read, and ours written, through this fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.errors import InputError

GOOD_PX = 0.02
"""Largest error at which no more coefficients are tried."""
WORST_RMS_PX = 1.5
"""Largest root mean square error of a fit that is accepted."""
_ANGLES, _TURNS = 160, 40


@dataclass(frozen=True)
class LensFit:
    """A fitted camera and its reprojection error over the image."""

    camera: Camera
    rms_px: float
    max_px: float


def exact(camera: Camera) -> LensFit:
    """A camera that needs no fit."""
    return LensFit(camera, 0.0, 0.0)


def fit_kannala_brandt(
    project: Callable[[Array], tuple[Array, Array]], width: int, height: int,
    terms: Sequence[int] = (4, 6, 8), skew: bool = True, widest: float = pi,
) -> LensFit:  # fmt: skip
    """The Kannala-Brandt camera nearest to a projection of rays (N, 3) to pixels and validity.

    The number of radial coefficients is the first of `terms` whose worst error is `GOOD_PX`, else
    the best. Without `skew` the affine matrix is diagonal. Rays up to `widest` [rad] count, as long
    as the radius grows with the angle. Raises InputError when the error exceeds `WORST_RMS_PX`, or
    nothing projects into the image.
    """
    theta, turn, pixels = _samples(project, width, height, min(widest, 0.995 * pi))
    best: LensFit | None = None
    for count in terms:
        found = _fitted(theta, turn, pixels, (width, height), count, skew)
        if found is not None and (best is None or found.max_px < best.max_px):
            best = found
        if best is not None and best.max_px <= GOOD_PX:
            break
    if best is None or best.rms_px > WORST_RMS_PX:
        left = "" if best is None else f": the best fit leaves {best.rms_px:.2f} px rms"
        raise InputError(f"no radial lens is near this camera model{left}",
                         valid=f"a lens within {WORST_RMS_PX} px rms of a radial one")  # fmt: skip
    return best


def as_kannala_brandt(camera: Camera) -> LensFit:
    """A camera as files of other programs have it: k1 to k4, no skew."""
    (_, skew), (shear, _) = camera.affine
    straight = skew == shear == 0.0
    if straight and camera.model == "equidistant":
        return exact(_camera(camera, (0.0,) * 4))
    if straight and camera.model == "kannala_brandt" and len(camera.parameters) == 4:
        return exact(camera)
    return fit_kannala_brandt(
        camera.project, camera.width, camera.height, (4,), skew=False, widest=camera.max_angle
    )


def _camera(camera: Camera, parameters: tuple[float, ...]) -> Camera:
    return Camera("kannala_brandt", camera.width, camera.height, camera.centre, camera.affine,
                  parameters, camera.max_angle)  # fmt: skip


def _samples(
    project: Callable[[Array], tuple[Array, Array]], width: int, height: int, widest: float
) -> tuple[Float[Array, "N"], Float[Array, "N"], Float[Array, "N 2"]]:
    """Angles off the axis and about it of rays that fall into the image, and their pixels."""
    angles = np.linspace(0.0, widest, _ANGLES + 1)[1:]
    theta, turn = np.meshgrid(angles, np.arange(_TURNS) * 2 * pi / _TURNS, indexing="ij")
    rays = np.stack([np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)], -1)
    pixels, valid = project(rays.reshape(-1, 3))
    pixels, valid = pixels.reshape(*theta.shape, 2), valid.reshape(theta.shape)
    axis, _ = project(np.array([[0.0, 0.0, 1.0]]))
    radius = np.linalg.norm(pixels - axis, axis=-1)
    grows = np.diff(radius, axis=0, prepend=0.0) > 0.0
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    # A model may come back into the image beyond its range: only the first stretch counts.
    kept = np.logical_and.accumulate(valid & grows & inside, axis=0)
    if kept.sum() < _TURNS:
        raise InputError("the camera model projects next to nothing into its image",
                         valid="a focal length and centre that fit the image size")  # fmt: skip
    return theta[kept], turn[kept], pixels[kept]


def _fitted(
    theta: Float[Array, "N"], turn: Float[Array, "N"], pixels: Float[Array, "N 2"],
    size: tuple[int, int], count: int, skew: bool,
) -> LensFit | None:  # fmt: skip
    from scipy.optimize import least_squares

    direction = np.stack([np.cos(turn), np.sin(turn)], -1)
    powers = theta[:, None] ** (2 * np.arange(1, count + 1) + 1)
    middle = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])

    def camera_matrix(x: Array) -> Array:
        return np.array([[x[2], x[4]], [x[5], x[3]]]) if skew else np.diag(x[2:4])

    def residual(x: Array) -> Array:
        radius = theta + powers @ x[len(x) - count :]
        return (x[:2] + radius[:, None] * direction @ camera_matrix(x).T - pixels).ravel()

    focal = np.median(np.linalg.norm(pixels - middle, axis=1) / theta)
    start = np.array([*middle, focal, focal, *((0.0, 0.0) if skew else ()), *count * [0.0]])
    found: Any = least_squares(residual, start, x_scale="jac", method="trf", max_nfev=300)
    x, error = found.x, np.linalg.norm(found.fun.reshape(-1, 2), axis=1)
    rows = camera_matrix(x).tolist()
    try:
        camera = Camera(
            "kannala_brandt", *size, (float(x[0]), float(x[1])),
            ((rows[0][0], rows[0][1]), (rows[1][0], rows[1][1])),
            tuple(x[len(x) - count :].tolist()), float(theta.max()),
        )  # fmt: skip
    except InputError:  # the radius does not grow throughout
        return None
    return LensFit(camera, float(np.sqrt((error**2).mean())), float(error.max()))
