"""Compiled forward kinematics for the kernels of tracker, image model and posterior.

`egocap.body.skeleton.forward` is the readable reference implementation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.body.skeleton import (
    AXES,
    DOF_JOINT,
    JOINTS,
    LABEL_POINTS,
    MOVES,
    POINT_PARENTS,
    HasOffsets,
)


class KinematicTree(NamedTuple):
    """Skeleton of a person as plain arrays. Joints precede end points."""

    offsets: Float[Array, "22 3"]  # from each point's parent at rest, metres
    parents: Int[Array, "22"]  # -1: the head
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]  # of each joint; the last entry is the total


class LabelChains(NamedTuple):
    """What moves the labels. An argument, as numba's cache misses changed tables."""

    points: Int[Array, "18"]  # of the labels
    dof_joint: Int[Array, "37"]  # the joint of each angle
    chains: Int[Array, "18 D"]  # the angles that move each label, -1 after the last


_PARENTS, _FIRST_DOF = (
    np.array(POINT_PARENTS), np.searchsorted(DOF_JOINT, np.arange(len(JOINTS) + 1))
)  # fmt: skip


def _label_chains() -> LabelChains:
    moves = [np.flatnonzero(MOVES[i]) for i in LABEL_POINTS]
    chains = np.full((len(moves), max(map(len, moves))), -1)
    for row, angles in zip(chains, moves, strict=True):
        row[: len(angles)] = angles
    return LabelChains(np.array(LABEL_POINTS), np.array(DOF_JOINT), chains)


LABEL_CHAINS = _label_chains()


def kinematic_tree(proportions: HasOffsets) -> KinematicTree:
    """The arrays for a person's proportions."""
    return KinematicTree(np.array(proportions.offsets), _PARENTS, AXES, _FIRST_DOF)


def label_positions(
    proportions: HasOffsets, angles: Float[Array, "T 37"]
) -> Float[Array, "T 18 3"]:
    """Positions of the labels in the head frame, metres, as `skeleton.forward` gives them."""
    found = np.empty((len(angles), len(LABEL_POINTS), 3))
    _pose_labels(
        kinematic_tree(proportions), LABEL_CHAINS.points, np.ascontiguousarray(angles, float), found
    )
    return found


@njit(cache=True, nogil=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def forward_kinematics(tree, angles, points, axes, R):
    """Pose a skeleton; all but the first two arguments are outputs, in the head frame.

    `tree` is a `KinematicTree` or another named tuple with its fields. `points` (N, 3) are the
    positions of the first N points, at least of all joints; `axes` (37, 3) the posed axis of every
    angle; `R` (17, 3, 3) the rotation of every joint.
    """
    for i in range(len(points)):
        parent = tree.parents[i]
        for r in range(3):
            if parent < 0:
                points[i, r] = tree.offsets[i, r]
            else:
                s = points[parent, r]
                for c in range(3):
                    s += R[parent, r, c] * tree.offsets[i, c]
                points[i, r] = s
        if i >= len(R):
            continue
        for r in range(3):
            for c in range(3):
                R[i, r, c] = R[parent, r, c] if parent >= 0 else (1.0 if r == c else 0.0)
        for d in range(tree.first_dof[i], tree.first_dof[i + 1]):
            x, y, z = tree.axes[d, 0], tree.axes[d, 1], tree.axes[d, 2]
            sin, cos = np.sin(angles[d]), np.cos(angles[d])
            v = 1.0 - cos
            q00, q01, q02 = cos + x * x * v, x * y * v - z * sin, x * z * v + y * sin
            q10, q11, q12 = x * y * v + z * sin, cos + y * y * v, y * z * v - x * sin
            q20, q21, q22 = x * z * v - y * sin, y * z * v + x * sin, cos + z * z * v
            for r in range(3):
                a, b, c = R[i, r, 0], R[i, r, 1], R[i, r, 2]
                axes[d, r] = a * x + b * y + c * z
                R[i, r, 0] = a * q00 + b * q10 + c * q20
                R[i, r, 1] = a * q01 + b * q11 + c * q21
                R[i, r, 2] = a * q02 + b * q12 + c * q22


@njit(cache=True, nogil=True)
def pose_skeleton(tree, angles):
    """Positions (22, 3) of all points and posed axes (37, 3) of all angles, as new arrays."""
    points, axes = np.empty((len(tree.parents), 3)), np.empty((len(angles), 3))
    forward_kinematics(tree, angles, points, axes, np.empty((len(tree.first_dof) - 1, 3, 3)))
    return points, axes


@njit(cache=True, nogil=True)
def _pose_labels(tree, labels, angles, found):
    for t in range(len(angles)):
        points, _ = pose_skeleton(tree, angles[t])
        for i in range(len(labels)):
            found[t, i] = points[labels[i]]
