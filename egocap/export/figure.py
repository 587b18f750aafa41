"""The figure of an exported animation: a tree of joints, an ellipsoid a bone, and their motion.

File axes: metres, y up, facing z, left is x. Each ellipsoid is bound rigidly to its joint and has
the colour of its side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.side_colours import side_colour
from egocap.data.bvh import (
    TO_FILE,
    BvhJoint,
    body_rotations,
    joint_tree,
    root_position,
    walk_tree,
)
from egocap.data.resampling import evenly
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.export.ellipsoid import Mesh, bone_mesh, joined

_SKIN = (217, 217, 217)  # RGB of the middle of the body


@dataclass(frozen=True, eq=False)
class Figure:
    """Joints with the hips first and parents before children, the skin, and the animation."""

    joints: list[BvhJoint]
    parents: list[int]  # index of each joint's parent; -1: none
    offsets: Float[Array, "N 3"]  # of each joint from its parent, at rest
    rest: Float[Array, "N 3"]  # places at rest
    mesh: Mesh  # at rest
    times: Float[Array, "T"]  # evenly spaced, the first is 0
    hips: Float[Array, "T 3"]
    quaternions: Float[Array, "T N 4"]  # (x, y, z, w) of each joint relative to its parent


def animated_figure(track: Track) -> Figure:
    """The figure of a track, resampled to even times.

    Raises InputError for a track without skeleton or whose times do not increase.
    """
    if track.offsets is None:
        raise InputError("the track does not hold its skeleton", valid="a track of schema 2")
    track = evenly(track)
    joints = list(walk_tree(joint_tree(np.asarray(track.offsets))))
    index = {id(joint): i for i, joint in enumerate(joints)}
    parents = [-1] * len(joints)
    for i, joint in enumerate(joints):
        for child in joint.children:
            parents[index[id(child)]] = i
    offsets = np.array([TO_FILE @ joint.offset for joint in joints])
    rest = offsets.copy()
    for i, parent in enumerate(parents[1:], 1):
        rest[i] += rest[parent]
    return Figure(
        joints, parents, offsets, rest, _skin(joints, rest), track.times - track.times[0],
        root_position(track), _local_quaternions(track, joints, parents),
    )  # fmt: skip


def _skin(joints: list[BvhJoint], rest: Float[Array, "N 3"]) -> Mesh:
    """Ellipsoids from each joint to its children and to its end."""
    meshes = []
    for i, joint in enumerate(joints):
        colour = side_colour(joint.body, _SKIN)
        tips = [child.offset for child in joint.children]
        tips += [] if joint.end is None else [joint.end]
        meshes += [bone_mesh(rest[i], TO_FILE @ tip, joint.body, i, colour) for tip in tips]
    return joined(meshes)


def _local_quaternions(
    track: Track, joints: list[BvhJoint], parents: list[int]
) -> Float[Array, "T N 4"]:
    """Each on the side of the one before: viewers interpolate them."""
    from scipy.spatial.transform import Rotation

    world = body_rotations(track)
    out = np.empty((len(track.times), len(joints), 4))
    for i, joint in enumerate(joints):
        R = world[joint.body]
        if i:
            R = np.swapaxes(world[joints[parents[i]].body], -1, -2) @ R
        q = Rotation.from_matrix(TO_FILE @ R @ TO_FILE.T).as_quat()
        turns = np.sign((q[1:] * q[:-1]).sum(1))
        signs = np.concatenate([[1.0], np.cumprod(np.where(turns < 0, -1.0, 1.0))])
        out[:, i] = q * signs[:, None]
    return out
