"""Rigid transforms, rotations, and the coordinate conventions of the project.

World: right-handed, metres, z up, gravity along -z; the person at rest faces +x, left is +y.
Camera frame (OpenCV): x right, y down, z forward. Pixel (0, 0) is the centre of the top-left pixel.
Head frame (= rig frame): fixed to the skull, origin at the skull base, axes parallel to the world's
when the person stands at rest. `T_a_b` is 4x4 and maps points of frame b into frame a.
Quaternions are w, x, y, z.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

FORWARD = np.array([1.0, 0.0, 0.0])
LEFT = np.array([0.0, 1.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])
GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


def unit(v: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """Scale vectors to length one; a zero vector stays zero."""
    n = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(n > 0, n, 1.0)


def rigid(
    rotation: Float[Array, "*batch 3 3"], translation: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 4 4"]:
    """Assemble homogeneous transforms from rotation matrices and translations."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    T = np.zeros((*batch, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = rotation, translation, 1.0
    return T


def inverse(T_a_b: Float[Array, "*batch 4 4"]) -> Float[Array, "*batch 4 4"]:
    """Invert rigid transforms: T_b_a from T_a_b."""
    R = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return rigid(R, -(R @ T_a_b[..., :3, 3:])[..., 0])


def transform(
    T_a_b: Float[Array, "*batch 4 4"], points_b: Float[Array, "*batch n 3"]
) -> Float[Array, "*batch n 3"]:
    """Map points of frame b into frame a; leading axes broadcast."""
    return points_b @ np.swapaxes(T_a_b[..., :3, :3], -1, -2) + T_a_b[..., None, :3, 3]


def axis_angle(
    axis: Float[Array, "*batch 3"], angle: Float[Array, "*batch"] | float
) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices about unit axes by angles in radians (Rodrigues' formula)."""
    axis, angle = np.asarray(axis, float), np.asarray(angle, float)[..., None, None]
    K = skew(axis)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def exponential(turn: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of rotation vectors, rad."""
    return axis_angle(unit(turn), np.linalg.norm(turn, axis=-1))


def right_jacobian(turn: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """J with exponential(turn + d) = exponential(turn) exponential(J d) for small d.

    Source: Sola, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics",
    equation 143.
    """
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    known = angle > 1e-5
    safe = np.where(known, angle, 1.0)
    first = np.where(known, (1.0 - np.cos(safe)) / safe**2, 0.5)
    second = np.where(known, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    K = skew(turn)
    return np.eye(3) - first * K + second * (K @ K)


def skew(v: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Cross-product matrices: skew(a) @ b == cross(a, b)."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(*x.shape, 3, 3)


def quaternion_to_matrix(q: Float[Array, "*batch 4"]) -> Float[Array, "*batch 3 3"]:
    """Rotation matrices of nonzero quaternions (w, x, y, z), which need not be of unit length."""
    w, x, y, z = np.moveaxis(unit(np.asarray(q, float)), -1, 0)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return np.stack(rows, -1).reshape(*w.shape, 3, 3)


def matrix_to_quaternion(R: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Unit quaternions (w, x, y, z), w >= 0, of rotation matrices."""
    from scipy.spatial.transform import Rotation

    R = np.asarray(R, float)
    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return q[:, [3, 0, 1, 2]].reshape(*R.shape[:-2], 4)
