"""Where the cameras of a data set are on the head, and the camera poses that its labels imply.

No data set states its cameras' pose relative to the skull. The head frame is therefore a constant
of the data set: its device frame, looking straight down with the image's upper edge in front
(`looking_down`), or, where the device's axes are unknown, the mean posture of the labels
(`upright`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.rig_files import camera_rotation
from egocap.errors import FileError
from egocap.evaluation.alignment import fit_similarity
from egocap.geometry import inverse, rigid, transform, unit

TOLERANCE_M = 2e-3  # labels of two frames of reference are one rigid body up to rounding


def looking_down(forward: float, up: float) -> Float[Array, "4 4"]:
    """T_head_device of a device whose z axis points down, y backwards; metres from the neck."""
    return rigid(camera_rotation(90.0), np.array([forward, 0.0, up]))


def upright(
    joints: Float[Array, "T 18 3"], labelled: Bool[Array, "T 18"]
) -> Float[Array, "4 4"] | None:
    """T_head_device from the median posture: origin at the neck, trunk upright, shoulders and hips
    level. None unless neck, shoulders and hips are labelled."""
    names = ("neck", "left_shoulder", "right_shoulder", "left_hip", "right_hip")
    index = [LABEL_INDEX[name] for name in names]
    rows = labelled[:, index].all(1)
    if not rows.any():
        return None
    neck, left_shoulder, right_shoulder, left_hip, right_hip = np.median(joints[rows][:, index], 0)
    up = unit(neck - 0.5 * (left_hip + right_hip))
    left = left_shoulder - right_shoulder + left_hip - right_hip
    left = unit(left - (left @ up) * up)
    R_device_head = np.stack([np.cross(left, up), left, up], -1)
    return inverse(rigid(R_device_head, neck))


def rigid_fit(
    points_b: Float[Array, "*n 3"], points_a: Float[Array, "*n 3"], where: Path, what: str
) -> Float[Array, "4 4"]:
    """T_a_b of points given in both frames. Raises FileError unless they differ rigidly."""
    b, a = points_b.reshape(-1, 3), points_a.reshape(-1, 3)
    _, R, t = fit_similarity(b, a, scaled=False)
    T_a_b = rigid(R, t)
    worst = float(np.abs(transform(T_a_b, b) - a).max())
    if worst > TOLERANCE_M:
        raise FileError(where, f"{what} are off a rigid motion by {1e3 * worst:.1f} mm",
                        valid=f"at most {1e3 * TOLERANCE_M:g} mm")  # fmt: skip
    return T_a_b


def head_poses(
    joints_head: Float[Array, "T J 3"], joints_world: Float[Array, "T J 3"]
) -> Float[Array, "T 4 4"] | None:
    """T_world_head of every frame from the same joints in both frames.

    None where they do not differ rigidly: then the world's axes are not what they should be.
    """
    _, R, t = fit_similarity(joints_head, joints_world, scaled=False)
    T_world_head = rigid(R, t)
    worst = np.abs(transform(T_world_head, joints_head) - joints_world).max()
    return T_world_head if worst < TOLERANCE_M else None
