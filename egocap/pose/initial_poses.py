"""Poses to start from when nothing is known: at the first frame and after the track was lost."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, DOF_INDEX

STARTS: dict[str, dict[str, float]] = {
    "rest": {},
    "arms forward": {"shoulder_raise": 65, "shoulder_swing": -30, "elbow_flexion": 25},
    "arms bent": {"shoulder_raise": 20, "elbow_flexion": 90},
    "arms sideways": {"shoulder_raise": 75, "shoulder_swing": 40, "clavicle_elevation": 10},
    "arms up": {"shoulder_raise": 140, "clavicle_elevation": 25, "elbow_flexion": 20},
    "squat": {
        "hip_flexion": 90, "knee_flexion": 100, "ankle_flexion": 20, "lower_spine_flexion": 15,
        "shoulder_raise": 50, "shoulder_swing": -20,
    },
    "sitting": {"hip_flexion": 85, "knee_flexion": 85, "shoulder_raise": 20, "elbow_flexion": 60},
    "bent forward": {
        "lower_spine_flexion": 35, "hip_flexion": 50, "knee_flexion": 15, "shoulder_raise": 60,
        "shoulder_swing": -20,
    },
    "looking down": {"neck_flexion": 30, "upper_spine_flexion": 15, "elbow_flexion": 30},
    "left step": {"left_hip_flexion": 30, "right_hip_flexion": -15, "right_knee_flexion": 25},
    "right step": {"right_hip_flexion": 30, "left_hip_flexion": -15, "left_knee_flexion": 25},
}  # fmt: skip
"""Angles in degrees by name; a name without its side sets both sides."""


def start_poses() -> Float[Array, "S 37"]:
    """All starting poses, radians."""
    poses = np.zeros((len(STARTS), DOF_COUNT))
    for pose, angles in zip(poses, STARTS.values(), strict=True):
        for name, degrees in angles.items():
            sides = [name] if name in DOF_INDEX else [f"left_{name}", f"right_{name}"]
            for side in sides:
                pose[DOF_INDEX[side]] = np.deg2rad(degrees)
    return poses
