"""The pose of a flat board from the rays of its corners, at any angle off the axis.

Source: the direct linear transform of a plane (Hartley and Zisserman 2004, 4.1) with the cross
products of unit rays in place of pixels, so that no ray is projected to z = 1.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.geometry import rigid, skew, unit

_STEPS = 12
_LEAST = 4  # corners


def planar_pose(
    rays: Float[Array, "n 3"], points: Float[Array, "n 3"]
) -> tuple[Float[Array, "4 4"], float]:
    """T_camera_board that aligns board points (z = 0) with unit rays, and its rms angle [rad].

    At least 4 points. The two poses that mirror each other about the line of sight are both tried.
    """
    assert len(rays) >= _LEAST, rays.shape
    T = _linear(rays, points)
    sight = unit(rays.mean(0))
    found = [refined_pose(start, rays, points) for start in (T, _mirrored(T, sight, points))]
    return min(found, key=lambda pair: pair[1])


def homography_residual(rays: Float[Array, "n 3"], points: Float[Array, "n 3"]) -> float:
    """RMS angle [rad] between rays and the best homography of the board, a pose or not."""
    H, middle, scale = _homography(rays, points)
    seen = unit(_homogeneous(points, middle, scale) @ H.T)
    return float(np.sqrt(np.mean(np.sum((seen - rays) ** 2, 1))))


def refined_pose(
    T: Float[Array, "4 4"], rays: Float[Array, "n 3"], points: Float[Array, "n 3"]
) -> tuple[Float[Array, "4 4"], float]:
    """Levenberg-Marquardt on the angles between rays and points; the pose and its rms [rad]."""
    across = _perpendicular(rays)  # (n, 2, 3)
    damping, error = 1e-4, _error(T, rays, points)
    for _ in range(_STEPS):
        moved = points @ T[:3, :3].T + T[:3, 3]
        length = np.linalg.norm(moved, axis=1)
        way = moved / length[:, None]
        residual = np.einsum("nkd,nd->nk", across, way)
        by_point = across - residual[:, :, None] * way[:, None, :]
        by_point /= length[:, None, None]
        J = np.concatenate([by_point @ -skew(moved - T[:3, 3]), by_point], 2).reshape(-1, 6)
        H, g = J.T @ J, J.T @ residual.ravel()
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g)
        new = moved_pose(T, step)
        worse = _error(new, rays, points)
        if worse < error:
            done = error - worse < 1e-9 * error
            T, error, damping = new, worse, damping / 5
            if done:
                break
        else:
            damping *= 10
    return T, error


def moved_pose(T: Float[Array, "*n 4 4"], step: Float[Array, "*n 6"]) -> Float[Array, "*n 4 4"]:
    """Turn poses by rotation vectors on the left and shift them: R <- exp(w) R, t <- t + dt."""
    turn = Rotation.from_rotvec(step[..., :3].reshape(-1, 3)).as_matrix()
    R = turn.reshape(*step.shape[:-1], 3, 3) @ T[..., :3, :3]
    return rigid(R, T[..., :3, 3] + step[..., 3:])


def _error(T: Array, rays: Array, points: Array) -> float:
    way = unit(points @ T[:3, :3].T + T[:3, 3])
    return float(np.sqrt(np.mean(np.sum((way - rays) ** 2, 1))))


def _perpendicular(rays: Float[Array, "n 3"]) -> Float[Array, "n 2 3"]:
    """Two unit vectors at right angles to each ray and to each other."""
    least = np.eye(3)[np.abs(rays).argmin(1)]
    first = unit(np.cross(rays, least))
    return np.stack([first, np.cross(rays, first)], 1)


def _homogeneous(points: Array, middle: Array, scale: float) -> Array:
    return np.column_stack([(points[:, :2] - middle) / scale, np.ones(len(points))])


def _homography(rays: Array, points: Array) -> tuple[Array, Array, float]:
    middle = points[:, :2].mean(0)
    scale = float(np.abs(points[:, :2] - middle).max())
    flat = _homogeneous(points, middle, scale)
    rows = (skew(rays)[:, :, :, None] * flat[:, None, None, :]).reshape(-1, 9)
    H = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    return H * np.sign(np.sum(rays * (flat @ H.T))), middle, scale


def _linear(rays: Array, points: Array) -> Float[Array, "4 4"]:
    H, middle, scale = _homography(rays, points)
    H = H * (2.0 * scale / (np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1])))
    a, b = H[:, 0] / scale, H[:, 1] / scale
    u, _, v = np.linalg.svd(np.column_stack([a, b, np.cross(a, b)]))
    R = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return rigid(R, H[:, 2] - R[:, :2] @ middle)


def _mirrored(T: Array, sight: Array, points: Array) -> Float[Array, "4 4"]:
    """The pose whose board normal is turned to the other side of the line of sight."""
    normal = T[:3, 2]
    turn = np.cross(normal, sight)
    flip = Rotation.from_rotvec(2.0 * turn).as_matrix()
    middle = points.mean(0)
    held = T[:3, :3] @ middle + T[:3, 3]
    R = flip @ T[:3, :3]
    return rigid(R, held - R @ middle)
