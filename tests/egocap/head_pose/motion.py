"""A known motion of the head, and of a device on it with another clock."""

import numpy as np
from scipy.spatial.transform import Rotation

from egocap.geometry import rigid

T_DEVICE_HEAD = rigid(Rotation.from_euler("zyx", [70.0, -20.0, 35.0], degrees=True).as_matrix(),
                      np.array([0.05, -0.08, 0.03]))  # fmt: skip


def head_motion(time):
    """T_world_head of a head that walks a curve, turns and nods."""
    t = np.asarray(time, float)
    yaw = 0.8 * np.sin(0.7 * t) + 0.3 * np.sin(2.3 * t + 1.0)
    pitch = 0.3 * np.sin(1.1 * t + 0.4) + 0.1 * np.sin(5.0 * t)
    roll = 0.2 * np.sin(1.7 * t + 2.0)
    R = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], -1)).as_matrix()
    p = np.stack([1.2 * t, np.sin(0.5 * t), 1.6 + 0.03 * np.sin(11.0 * t)], -1)
    return rigid(R, p)


def quaternions(R):
    """x, y, z, w of rotation matrices."""
    return Rotation.from_matrix(R).as_quat()
