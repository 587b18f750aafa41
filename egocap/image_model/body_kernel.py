"""Posed Gaussians, and forces on their centres as forces on the joint angles, compiled.

An angle turns what hangs below it about its posed axis a through its joint's origin o. A force f on
a point x below does the work a . ((x - o) x f) a radian: forces and moments are summed up the tree
of joints, and every angle reads its own off once. The readable form is `image_model.torch_pose`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import AXES, DOF_JOINT, JOINTS, POINT_PARENTS


class Chain(NamedTuple):
    """Skeleton and Gaussians as plain arrays. Frame 0 is the skull, frame i + 1 is joint i."""

    bones: Float[Array, "17 3"]  # rest offset of each joint
    parents: Int[Array, "17"]  # frame of each joint's parent
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]  # of each joint, and the total at the end
    carrier: Int[Array, "G"]  # frame of each Gaussian
    offset: Float[Array, "G 3"]


def make_chain(body: GaussianBody) -> Chain:
    """Gather what the kernels need of a body."""
    joints = len(JOINTS)
    return Chain(
        np.array(body.proportions.offsets[:joints]), np.array(POINT_PARENTS[:joints]) + 1,
        np.array(AXES), np.searchsorted(DOF_JOINT, np.arange(joints + 1)), body.joint + 1,
        np.array(body.offset),
    )  # fmt: skip


@njit(cache=True)
def pose(chain, angles, origins, axes, centres):
    """Origins (18, 3) of frames, posed axes (37, 3), centres (G, 3) of Gaussians: all output."""
    frames = len(origins)
    R = np.empty((frames, 3, 3))
    Q = np.empty((3, 3))
    origins[0] = 0.0
    R[0] = np.eye(3)
    for i in range(frames - 1):
        p, f = chain.parents[i], i + 1
        for r in range(3):
            origins[f, r] = origins[p, r]
            for c in range(3):
                origins[f, r] += R[p, r, c] * chain.bones[i, c]
                R[f, r, c] = R[p, r, c]
        for d in range(chain.first_dof[i], chain.first_dof[i + 1]):
            x, y, z = chain.axes[d, 0], chain.axes[d, 1], chain.axes[d, 2]
            sin, cos = np.sin(angles[d]), np.cos(angles[d])
            v = 1.0 - cos
            Q[0, 0], Q[0, 1], Q[0, 2] = cos + x * x * v, x * y * v - z * sin, x * z * v + y * sin
            Q[1, 0], Q[1, 1], Q[1, 2] = x * y * v + z * sin, cos + y * y * v, y * z * v - x * sin
            Q[2, 0], Q[2, 1], Q[2, 2] = x * z * v - y * sin, y * z * v + x * sin, cos + z * z * v
            for r in range(3):
                a, b, e = R[f, r, 0], R[f, r, 1], R[f, r, 2]
                axes[d, r] = a * x + b * y + e * z
                for c in range(3):
                    R[f, r, c] = a * Q[0, c] + b * Q[1, c] + e * Q[2, c]
    for q in range(len(centres)):
        f = chain.carrier[q]
        for r in range(3):
            centres[q, r] = origins[f, r]
            for c in range(3):
                centres[q, r] += R[f, r, c] * chain.offset[q, c]


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def load(wrench, frame, centre, force):
    """Add a force (3,) at a centre to the force and moment (6,) of a frame."""
    w = wrench[frame]
    w[0] += force[0]
    w[1] += force[1]
    w[2] += force[2]
    w[3] += centre[1] * force[2] - centre[2] * force[1]
    w[4] += centre[2] * force[0] - centre[0] * force[2]
    w[5] += centre[0] * force[1] - centre[1] * force[0]


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def angle_forces(chain, origins, axes, wrench, loaded, row, which):
    """Derivatives by the angles from the wrenches (18, 6) on the frames, which are used up.

    Only frames with `loaded` (18,) count; both are cleared. The angles concerned go into `which`,
    their derivatives into `row` at the same places; returns how many.
    """
    count = 0
    for i in range(len(chain.parents) - 1, -1, -1):
        f = i + 1
        if not loaded[f]:
            continue
        w, o, p = wrench[f], origins[f], chain.parents[i]
        mx = w[3] - (o[1] * w[2] - o[2] * w[1])
        my = w[4] - (o[2] * w[0] - o[0] * w[2])
        mz = w[5] - (o[0] * w[1] - o[1] * w[0])
        for d in range(chain.first_dof[i], chain.first_dof[i + 1]):
            which[count] = d
            row[count] = axes[d, 0] * mx + axes[d, 1] * my + axes[d, 2] * mz
            count += 1
        for c in range(6):
            wrench[p, c] += w[c]
            w[c] = 0.0
        loaded[f] = False
        loaded[p] = True
    for c in range(6):
        wrench[0, c] = 0.0
    loaded[0] = False
    return count
