"""Posed Gaussians, and forces on their centres as derivatives by the joint angles, compiled.

An angle turns what hangs below it about its posed axis a through its joint's origin o. A force f on
a point x below does the work a . ((x - o) x f) a radian: forces and moments are summed up the tree
of joints, and every angle's derivative is read off once. `torch_visibility` has the readable form.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.kinematics import forward_kinematics, kinematic_tree
from egocap.body.skeleton import DOF_COUNT, JOINTS


class Chain(NamedTuple):
    """Skeleton (as `KinematicTree`, joints only) and Gaussians as plain arrays."""

    offsets: Float[Array, "17 3"]
    parents: Int[Array, "17"]
    axes: Float[Array, "37 3"]
    first_dof: Int[Array, "18"]
    carrier: Int[Array, "G"]  # joint that carries each Gaussian; -1: the skull
    offset: Float[Array, "G 3"]  # from that joint


def make_chain(body: GaussianBody) -> Chain:
    """The arrays of a body."""
    joints, bones = len(JOINTS), kinematic_tree(body.proportions)
    return Chain(
        bones.offsets[:joints], bones.parents[:joints], bones.axes, bones.first_dof,
        np.array(body.joint), np.array(body.offset),
    )  # fmt: skip


def gaussian_centres(angles: Float[Array, "B 37"], body: GaussianBody) -> Float[Array, "B G 3"]:
    """Centres of the body's Gaussians in the head frame, metres."""
    chain = make_chain(body)
    origins, axes = np.empty((len(JOINTS), 3)), np.empty((DOF_COUNT, 3))
    centres = np.empty((len(angles), len(body.sigma), 3))
    for row, out in zip(np.ascontiguousarray(angles, float), centres, strict=True):
        pose(chain, row, origins, axes, out)
    return centres


@njit(cache=True)
def pose(chain, angles, origins, axes, centres):
    """Origins (17, 3) of joints, posed axes (37, 3), centres (G, 3) of Gaussians: all output."""
    R = np.empty((len(origins), 3, 3))
    forward_kinematics(chain, angles, origins, axes, R)
    for q in range(len(centres)):
        i = chain.carrier[q]
        for r in range(3):
            if i < 0:
                centres[q, r] = chain.offset[q, r]
                continue
            centres[q, r] = origins[i, r]
            for c in range(3):
                centres[q, r] += R[i, r, c] * chain.offset[q, c]


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def add_force(wrench, joint, centre, force):
    """Add a force (3,) at a centre to the force and moment (6,) on a joint."""
    w = wrench[joint]
    w[0] += force[0]
    w[1] += force[1]
    w[2] += force[2]
    w[3] += centre[1] * force[2] - centre[2] * force[1]
    w[4] += centre[2] * force[0] - centre[0] * force[2]
    w[5] += centre[0] * force[1] - centre[1] * force[0]


@njit(cache=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def angle_derivatives(chain, origins, axes, wrench, loaded, row, which):
    """Derivatives by the angles from the wrenches (17, 6) on the joints.

    Only joints with `loaded` (17,) count; both arrays are cleared. The angles concerned go into
    `which`, their derivatives into `row` at the same places; returns how many.
    """
    count = 0
    for i in range(len(chain.parents) - 1, -1, -1):
        if not loaded[i]:
            continue
        w, o, p = wrench[i], origins[i], chain.parents[i]
        mx = w[3] - (o[1] * w[2] - o[2] * w[1])
        my = w[4] - (o[2] * w[0] - o[0] * w[2])
        mz = w[5] - (o[0] * w[1] - o[1] * w[0])
        for d in range(chain.first_dof[i], chain.first_dof[i + 1]):
            which[count] = d
            row[count] = axes[d, 0] * mx + axes[d, 1] * my + axes[d, 2] * mz
            count += 1
        for c in range(6):
            if p >= 0:
                wrench[p, c] += w[c]
            w[c] = 0.0
        loaded[i] = False
        if p >= 0:
            loaded[p] = True
    return count
