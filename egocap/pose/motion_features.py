"""Inputs of the motion network: poses, how well their joints are known, and the head's motion.

In: a track's angles, the joints' standard deviations and, where known, the head's poses in a world
with z up. Out: numbers of unit size at every frame. Lengths are relative to the person's stature;
nothing depends on where in the world the person is, nor which way it faces.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.kinematics import label_positions
from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import (
    DOF_COUNT,
    LABEL_POINTS,
    SPREAD,
    HasOffsets,
    rest_points,
)
from egocap.data.head_pose import HeadPoses
from egocap.geometry import transform

POSE_COUNT, HEAD_COUNT = DOF_COUNT + 4 * len(LABEL_INDEX), 40
GROUPS = (slice(0, 6), slice(6, 21), slice(21, 40))
"""Head features that need its orientation against gravity, its position too, and the floor too."""
_FEET = [LABEL_INDEX[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")]
_LEAST_STD, _USUAL_STD = 1e-3, 0.02  # m
_FLOOR_QUANTILE, _FOOT_M = 0.1, -0.014
"""Quantile over the frames of the feet's lowest joint, and its height above the floor as tracked
(median over the takes)."""


def stature(proportions: HasOffsets) -> float:
    """Height of the head label above the ankles at rest, metres."""
    rest = rest_points(proportions)[list(LABEL_POINTS)]
    ankles = [LABEL_INDEX["left_ankle"], LABEL_INDEX["right_ankle"]]
    return float(rest[LABEL_INDEX["head"], 2] - rest[ankles, 2].mean())


def pose_features(
    angles: Float[Array, "T 37"], std: Float[Array, "T 18"], proportions: HasOffsets
) -> Float[Array, "T 109"]:
    """Angles, joints in the head frame, and logarithms of the joints' standard deviations [m]."""
    joints = label_positions(proportions, angles) / stature(proportions)
    return np.concatenate([
        0.7 * angles / SPREAD, 2.0 * joints.reshape(len(angles), -1),
        np.log(np.maximum(std, _LEAST_STD) / _USUAL_STD),
    ], axis=1)  # fmt: skip


def head_features(
    times: Float[Array, "T"], angles: Float[Array, "T 37"], proportions: HasOffsets,
    heads: HeadPoses | None,
) -> Float[Array, "T 40"]:  # fmt: skip
    """Gravity and rates of turning in the head frame; velocities of head and feet along heading,
    left and up; heights of head and joints above the feet's lowest places. 0 without a head pose.
    """
    if heads is None or not heads.known.any():
        return np.zeros((len(angles), HEAD_COUNT))
    T, length = heads.T_world_head, stature(proportions)
    joints = transform(T, label_positions(proportions, angles))
    points = np.concatenate([T[:, None, :3, 3], joints[:, _FEET]], 1)
    along = _along_heading(T, _rate(times, points)) / length
    along *= np.array([1.5, 0.5, 0.5, 0.5, 0.5])[:, None]
    heights = np.concatenate([T[:, 2:3, 3], joints[..., 2]], 1)
    lowest = joints[:, _FEET, 2].min(axis=1)[heads.known]
    heights = 3.0 * (heights - np.quantile(lowest, _FLOOR_QUANTILE) + _FOOT_M) / length
    heights[:, 0] -= 2.0
    features = [1.5 * T[:, 2, :3], 0.7 * _turning(times, T), along.reshape(len(T), -1), heights]
    return np.concatenate(features, axis=1) * heads.known[:, None]


def _turning(times: Float[Array, "T"], T_world_head: Float[Array, "T 4 4"]) -> Array:
    """Angular velocity in the head frame (T, 3), rad/s; for small turns from frame to frame."""
    R = T_world_head[:, :3, :3]
    turn = np.swapaxes(R[:-1], 1, 2) @ R[1:]
    twice = [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
             turn[:, 1, 0] - turn[:, 0, 1]]  # fmt: skip
    rates = 0.5 * np.stack(twice, -1) / np.diff(times)[:, None]
    if not len(rates):
        return np.zeros((len(R), 3))
    return np.concatenate([rates[:1], 0.5 * (rates[1:] + rates[:-1]), rates[-1:]])


def _rate(times: Float[Array, "T"], points: Float[Array, "T K 3"]) -> Float[Array, "T K 3"]:
    return np.zeros_like(points) if len(times) < 2 else np.gradient(points, times, axis=0)


def _along_heading(
    T_world_head: Float[Array, "T 4 4"], vectors: Float[Array, "T K 3"]
) -> Float[Array, "T K 3"]:
    """World vectors along the heading (the head's x axis, made horizontal), left of it and up."""
    ahead = T_world_head[:, :2, 0]
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-3)
    forwards = np.einsum("ti,tki->tk", ahead, vectors[..., :2])
    left = ahead[:, None, 0] * vectors[..., 1] - ahead[:, None, 1] * vectors[..., 0]
    return np.stack([forwards, left, vectors[..., 2]], -1)
