"""Align a retargeted motion with the floor: height, standing feet, no foot sliding.

A stance is an interval in which a corner of a side's two soles is low and slow. In a stance
two-bone inverse kinematics keeps the standing corners fixed at z = 0; in between the correction is
interpolated.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d

from egocap_sim.human.body.person import Person
from egocap_sim.human.body.soles import sole_corners, soles
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.kinematics.limbs import bend_limb

_FLOOR_PERCENTILE = 8.0  # of the lowest sole's height: robust against a few low frames
_NEAR = 0.10  # metres: a slow lowest sole point this close to the floor is standing on it
_STEP = 0.35  # metres: the highest step that counts as ground
_STEP_S = 0.2  # the least time on a step, seconds
_SLOW = 0.5  # metres a second
_DRIFT_S = 0.06  # standard deviation of the height correction over time, seconds
_STANCE_HEIGHT = 0.03  # metres
_SHORTEST_S = 0.06  # a shorter stance is noise, seconds
_FARTHEST = 0.10  # metres: the most a foot is moved horizontally
_GAP_S = 0.08  # a shorter break in standing is noise, seconds
_EASE_S = 0.02  # standard deviation of the smoothing of corrections, seconds
_TOUCH_HEIGHT = 0.01  # metres: a foot this low touches the floor even while it slides
_GATE_SPEED = 0.5  # metres a second: a low foot slower than this may touch the floor


def plant(
    person: Person, root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], fps: float
) -> tuple[Float[Array, "T 3"], Float[Array, "T 21 3 3"], Bool[Array, "T 4"], Bool[Array, "T 4"]]:
    """Fix standing soles at z = 0.

    Returns root positions, body rotations, which feet stand and which at least touch the floor
    (`egocap_sim.core.bodies.FEET`).
    """
    boxes = soles(person)
    root = snap(
        sole_corners(boxes, joint_positions(person.joints, root, turned), turned), root, fps
    )
    points = sole_corners(boxes, joint_positions(person.joints, root, turned), turned)
    moves = [foot_correction(points[:, 2 * s : 2 * s + 2], fps) for s in range(2)]
    for side, move in zip(("l", "r"), moves, strict=True):
        positions = joint_positions(person.joints, root, turned)
        turned = bend_limb(positions, turned, side, move)
    points = sole_corners(boxes, joint_positions(person.joints, root, turned), turned)
    return root, turned, standing(points, fps), points[..., 2].min(-1) < _TOUCH_HEIGHT


def snap(
    points: Float[Array, "T 4 4 3"], root: Float[Array, "T 3"], fps: float
) -> Float[Array, "T 3"]:
    """Shift the root vertically: one offset for the clip and a slow one while a foot stands.

    `points` are the corners of the soles.
    """
    points = points.reshape(len(root), -1, 3)
    frames, corner = np.arange(len(root)), points[..., 2].argmin(1)
    lowest, speed = points[frames, corner, 2], _speed(points, fps)[frames, corner]
    lowest = lowest - (offset := np.percentile(lowest, _FLOOR_PERCENTILE))
    stands = (np.abs(lowest) < _NEAR) & (speed < _SLOW)
    # Uneven ground is levelled; the top of a jump is as slow, but shorter.
    for first, end in _runs((np.abs(lowest) < _STEP) & (speed < _SLOW)):
        if end - first >= _STEP_S * fps:
            stands[first:end] = True
    drift = np.interp(frames, frames[stands], lowest[stands]) if stands.any() else 0.0 * lowest
    drift = gaussian_filter1d(drift, _DRIFT_S * fps, mode="nearest")
    return root - np.outer(offset + drift, [0, 0, 1])


def foot_correction(points: Float[Array, "T 2 4 3"], fps: float) -> Float[Array, "T 3"]:
    """Displacement of one foot that keeps its standing corners fixed at z = 0, metres.

    `points` are the corners of the soles of its foot and toes.
    """
    points = points.reshape(len(points), -1, 3)
    velocity = np.gradient(points, 1 / fps, axis=0)
    height, speed = points[..., 2], np.linalg.norm(velocity, axis=-1)
    weight = np.clip(1 - height / _STANCE_HEIGHT, 0, 1) * np.clip(1 - speed / _SLOW, 0, 1)
    total = weight.sum(1)
    slide = (weight[..., None] * velocity).sum(1) / np.maximum(total, 1e-9)[:, None]
    stances = [s for s in _runs(total > 0.05) if s[1] - s[0] >= _SHORTEST_S * fps]
    if not stances:
        return np.zeros((len(points), 3))
    frames, move = np.arange(len(points)), np.zeros((len(points), 3))
    known = np.zeros(len(points), bool)
    for first, end in stances:
        path = np.cumsum(slide[first:end], axis=0) / fps
        move[first:end, :2] = (path.mean(0) - path)[:, :2]
        move[first:end, 2] = -height[first:end].min(1)
        known[first:end] = True
    for axis in range(3):
        move[:, axis] = np.interp(frames, frames[known], move[known, axis])
    move[:, 2] = np.maximum(move[:, 2], -height.min(1))
    move = gaussian_filter1d(move, _EASE_S * fps, axis=0, mode="nearest")
    length = np.linalg.norm(move[:, :2], axis=1, keepdims=True)
    move[:, :2] *= np.minimum(1.0, _FARTHEST / np.maximum(length, 1e-9))
    return move


def standing(points: Float[Array, "T 4 4 3"], fps: float) -> Bool[Array, "T 4"]:
    """Which soles have a low and slow corner; short gaps of low soles are closed."""
    low = points[..., 2] < _STANCE_HEIGHT
    slow = _speed(points, fps) < _GATE_SPEED
    stands = np.asarray((low & slow).any(-1))
    for foot in range(stands.shape[1]):
        for first, end in _runs(~stands[:, foot]):
            inside = first > 0 and end < len(stands)
            if inside and end - first <= _GAP_S * fps and low[first:end, foot].any(-1).all():
                stands[first:end, foot] = True
    return stands


def _speed(points: Float[Array, "T *n 3"], fps: float) -> Float[Array, "T *n"]:
    """Speed of points along axis 0, metres a second."""
    return np.linalg.norm(np.gradient(points, 1 / fps, axis=0), axis=-1)


def _runs(flags: Bool[Array, "T"]) -> list[tuple[int, int]]:
    """First and one-past-last frames of the runs of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
