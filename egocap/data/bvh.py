"""Export of a track as BVH, for Blender and other animation tools.

The file's skeleton is rooted at the hips, as such tools expect; the tracker's at the head. With a
known head pose the motion is in the world, otherwise in the head frame. Metres; y up, facing z,
left is x.

Source: the format, Meredith & Maddock 2001, "Motion capture file formats explained".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.body.skeleton import JOINTS, POINT_INDEX, joint_rotations, points
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.files import write_atomically

TO_FILE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""Axes of the project (x forward, y left, z up) to those of the file (x left, y up, z forward)."""
SHORTEST_S, LONGEST_S = 1e-5, 1.0
"""Time between frames that readers of the format take; the file states eight decimals of it."""
_CHANNELS = "Zrotation Xrotation Yrotation"
_HEAD = "skull"  # the body above the neck joint
_SIDES = {"left": "Left", "right": "Right"}
_LIMBS = {
    "clavicle": ("Shoulder", "shoulder"), "shoulder": ("Arm", "elbow"), "elbow": ("ForeArm",
    "wrist"), "wrist": ("Hand", "hand"), "hip": ("UpLeg", "knee"), "knee": ("Leg", "ankle"),
    "ankle": ("Foot", "foot"),
}  # fmt: skip
"""Joint -> (name in the file, point at the end of its bone)."""


@dataclass(frozen=True, eq=False)
class BvhJoint:
    """One joint of the file, its offset and its children."""

    name: str
    body: str  # tracker joint with the same frame, or `_HEAD`
    offset: Float[Array, "3"]  # in the parent's frame at rest, metres
    children: list[BvhJoint] = field(default_factory=list)
    end: Float[Array, "3"] | None = None  # end of the bone, for the last joint of a limb


def write_bvh(path: str | Path, track: Track) -> None:
    """Write a track as BVH, atomically.

    Raises InputError as `bvh_text`; FileError or MachineError as `egocap.files.disk_errors`.
    """
    write_atomically(Path(path), bvh_text(track))


def bvh_text(track: Track) -> str:
    """Content of the file. Raises InputError for a track without skeleton, and as `frame_time`."""
    if track.offsets is None:
        raise InputError("the track does not hold its skeleton", valid="a track of schema 2")
    root = joint_tree(np.asarray(track.offsets))
    nodes = list(walk_tree(root))
    world = body_rotations(track)
    columns = [root_position(track)]
    parent = {id(child): node for node in nodes for child in node.children}
    for node in nodes:
        R = world[node.body]
        above = parent.get(id(node))
        local = R if above is None else np.swapaxes(world[above.body], -1, -2) @ R
        columns.append(_euler_degrees(TO_FILE @ local @ TO_FILE.T))
    lines = ["HIERARCHY", *_describe(root, 0, first=True), "MOTION", f"Frames: {len(track.times)}",
             f"Frame Time: {frame_time(track):.8f}"]  # fmt: skip
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.concatenate(columns, axis=1)]
    return "\n".join(lines) + "\n"


def joint_tree(offsets: Float[Array, "22 3"]) -> BvhJoint:
    """Joints from the hips (the lower spine's joint) to legs, spine, arms and head."""
    at = {name: offsets[i] for name, i in POINT_INDEX.items()}
    root = BvhJoint("Hips", "lower_spine", np.zeros(3))
    spine = BvhJoint("Spine", "upper_spine", np.zeros(3))
    neck = BvhJoint("Neck", "neck", -at["lower_spine"])
    neck.children.append(BvhJoint("Head", _HEAD, -at["upper_spine"], [], at["head"] - at["neck"]))
    for side in _SIDES:
        root.children.append(_limb(side, ("hip", "knee", "ankle"), at[f"{side}_hip"], at))
        clavicle = at[f"{side}_clavicle"] - at["lower_spine"]
        spine.children.append(_limb(side, ("clavicle", "shoulder", "elbow", "wrist"), clavicle, at))
    spine.children.append(neck)
    root.children.append(spine)
    return root


def _limb(
    side: str, joints: tuple[str, ...], offset: Float[Array, "3"], at: dict[str, Array]
) -> BvhJoint:
    name, tip = _LIMBS[joints[0]]
    node = BvhJoint(_SIDES[side] + name, f"{side}_{joints[0]}", offset)
    if len(joints) > 1:
        node.children.append(_limb(side, joints[1:], at[f"{side}_{joints[1]}"], at))
        return node
    return BvhJoint(node.name, node.body, offset, [], at[f"{side}_{tip}"])


def walk_tree(node: BvhJoint) -> Iterator[BvhJoint]:
    """A node and its descendants in file order."""
    yield node
    for child in node.children:
        yield from walk_tree(child)


def _describe(node: BvhJoint, depth: int, *, first: bool = False) -> list[str]:
    pad = "\t" * depth
    x, y, z = TO_FILE @ node.offset
    channels = f"CHANNELS 6 Xposition Yposition Zposition {_CHANNELS}" if first else (
        f"CHANNELS 3 {_CHANNELS}"
    )  # fmt: skip
    lines = [f"{pad}{'ROOT' if first else 'JOINT'} {node.name}", f"{pad}{{",
             f"{pad}\tOFFSET {x:.6f} {y:.6f} {z:.6f}", f"{pad}\t{channels}"]  # fmt: skip
    for child in node.children:
        lines += _describe(child, depth + 1)
    if node.end is not None:
        x, y, z = TO_FILE @ node.end
        lines += [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET {x:.6f} {y:.6f} {z:.6f}",
                  f"{pad}\t}}"]  # fmt: skip
    return [*lines, f"{pad}}}"]


def body_rotations(track: Track) -> dict[str, Float[Array, "T 3 3"]]:
    """Rotation of every body in the world if known, else in the head frame."""
    frames = joint_rotations(track.angles)  # (T, 17, 3, 3)
    T = len(track.times)
    head = np.broadcast_to(np.eye(3), (T, 3, 3))
    if track.T_world_head is not None:
        head = track.T_world_head[:, :3, :3]
    rotations = {joint.name: head @ frames[:, i] for i, joint in enumerate(JOINTS)}
    return rotations | {_HEAD: head}


def root_position(track: Track) -> Float[Array, "T 3"]:
    """Place of the hips, in the file's axes, metres."""
    assert track.offsets is not None
    hips = points(Proportions(track.offsets), track.angles)[:, POINT_INDEX["lower_spine"]]
    if track.T_world_head is not None:
        T = track.T_world_head
        hips = np.einsum("tij,tj->ti", T[:, :3, :3], hips) + T[:, :3, 3]
    return hips @ TO_FILE.T


def _euler_degrees(R: Float[Array, "T 3 3"]) -> Float[Array, "T 3"]:
    """Intrinsic ZXY Euler angles, unwrapped over time."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(R).as_euler("ZXY")
    return np.rad2deg(np.unwrap(angles, axis=0))


def frame_time(track: Track) -> float:
    """Seconds per frame. Raises InputError for uneven times, and for frames too near or far."""
    if len(track.times) < 2:
        return 1.0 / 30.0
    steps = np.diff(track.times)
    if steps.max() - steps.min() > 0.02 * steps.mean():
        raise InputError("the track's frames are not evenly spaced", valid="an even frame rate")
    if not SHORTEST_S <= steps.mean() <= LONGEST_S:
        raise InputError(f"the track's frames are {steps.mean():g} s apart",
                         valid=f"{SHORTEST_S:g} to {LONGEST_S:g} s")  # fmt: skip
    return float(steps.mean())
