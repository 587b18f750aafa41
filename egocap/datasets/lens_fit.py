"""Calibration of cameras from a data set's own labels: 3-D points and the pixels they project to.

For data sets that publish projected joints and no calibration file. The lens model is Kannala and
Brandt's; the residual says whether it fits.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.errors import FileError, InputError
from egocap.geometry import rigid, transform, unit

TOLERANCE_PX = 0.5  # median residual of a fit
MOST_POINTS = 800  # enough for 11 parameters; more take time
_POWERS = np.array([1, 3, 5, 7, 9])


def fit_lens(
    points: Float[Array, "N 3"],
    pixels: Float[Array, "N 2"],
    size: tuple[int, int],
    where: Path,
) -> Camera:
    """The lens that projects points [m, camera frame, in front of it] to pixels.

    Its field of view ends at the widest point. Raises FileError where no such lens fits.
    """
    points, pixels = _chosen(points, pixels)
    start = np.array([size[0] / 3, size[1] / 3, size[0] / 2, size[1] / 2, 0, 0, 0, 0])
    found, residual = _least_squares(lambda x: _project(points, x) - pixels, start)
    return _camera(found, points, size, residual, where)


def fit_camera(
    points: Float[Array, "N 3"],
    pixels: Float[Array, "N 2"],
    depths: Float[Array, "N"],
    size: tuple[int, int],
    where: Path,
) -> tuple[Camera, Float[Array, "4 4"]]:
    """Lens and pose T_camera_device from points of the device's frame, their pixels and depths.

    `depths` are z in the camera frame [m] and give the optical axis by linear least squares, the
    pixels' directions from the middle of the image the orientation about it; all but the axis is
    refined. Raises FileError where no camera fits.
    """
    columns = np.column_stack([points, np.ones(len(points))])
    (*axis, offset), *_ = np.linalg.lstsq(columns, depths, rcond=None)
    if abs(np.linalg.norm(axis) - 1.0) > 0.01:
        raise FileError(where, "the projected joints' depths are no distances along one axis",
                        valid="depths in centimetres of a rigid camera")  # fmt: skip
    points, pixels = _chosen(points, pixels)
    R = _any_rotation(unit(np.array(axis)))
    centred, seen = pixels - np.array(size) / 2, points @ R.T
    turns = np.arctan2(centred[:, 1], centred[:, 0]) - np.arctan2(seen[:, 1], seen[:, 0])
    lens = [size[0] / 3, size[0] / 3, size[0] / 2, size[1] / 2, 0, 0, 0, 0]

    def difference(x: Array) -> Array:
        return _project(transform(_pose(x[8:], R, offset), points), x[:8]) - pixels

    turn = np.angle(np.exp(1j * turns).sum())
    found, residual = _least_squares(difference, np.array([*lens, turn, 0.0, 0.0]))
    T_camera_device = _pose(found[8:], R, offset)
    camera = _camera(found[:8], transform(T_camera_device, points), size, residual, where)
    return camera, T_camera_device


def _pose(x: Array, R: Array, offset: float) -> Array:
    """T_camera_device: R turned about the optical axis, at a position in the image plane."""
    c, s = np.cos(x[0]), np.sin(x[0])
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    return rigid(turned, np.array([x[1], x[2], offset]))


def _any_rotation(axis: Array) -> Array:
    """A rotation whose last row is `axis`."""
    side = unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))
    return np.stack([side, np.cross(axis, side), axis])


def _project(points: Array, lens: Array) -> Array:
    """Pixels by fx, fy, cx, cy, k1..k4, without the camera's limits."""
    rho = np.maximum(np.linalg.norm(points[:, :2], axis=1), 1e-12)
    theta = np.arctan2(rho, points[:, 2])
    radius = theta[:, None] ** _POWERS @ np.array([1.0, *lens[4:]])
    return points[:, :2] * (radius / rho)[:, None] * lens[:2] + lens[2:4]


def _least_squares(difference: Callable[[Array], Array], start: Array) -> tuple[Array, float]:
    """Parameters and the median distance in pixels; robust to a few wrong points."""
    from scipy.optimize import least_squares

    scale = np.maximum(np.abs(start), 0.1)
    lowest = np.full(len(start), -np.inf)
    lowest[:2] = 1.0  # focal lengths: negative ones are another turn about the axis
    result = least_squares(
        lambda x: difference(x).ravel(), start, bounds=(lowest, np.inf), x_scale=scale,
        loss="soft_l1", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200,
    )  # fmt: skip
    return result.x, float(np.median(np.linalg.norm(difference(result.x), axis=1)))


def _camera(x: Array, points: Array, size: tuple[int, int], residual: float, where: Path) -> Camera:
    if not residual < TOLERANCE_PX:
        problem = f"no fisheye lens fits the projected joints: {residual:.2f} px (median)"
        raise FileError(where, problem, valid=f"below {TOLERANCE_PX} px")
    widest = float(np.arctan2(np.linalg.norm(points[:, :2], axis=1), points[:, 2]).max())
    affine = ((float(x[0]), 0.0), (0.0, float(x[1])))
    centre, parameters = (float(x[2]), float(x[3])), tuple(float(k) for k in x[4:8])
    try:
        return Camera("kannala_brandt", *size, centre, affine, parameters, widest)
    except InputError as error:
        raise FileError(where, f"the projected joints' lens is refused: {error}") from None


def _chosen(points: Array, pixels: Array) -> tuple[Array, Array]:
    """At most MOST_POINTS, evenly spaced: neighbouring frames say the same."""
    rows = np.unique(np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(int))
    return points[rows], pixels[rows]
