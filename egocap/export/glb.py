"""A track as GLB (binary glTF 2.0): a skinned figure with its skeleton's animation.

Metres; y up, facing z, left is x. The figure has an ellipsoid a bone, bound rigidly to it and in
the colour of its side. Rotations and the place of the hips are keyframes of every frame.

Source: Khronos Group, glTF 2.0 Specification.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

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
from egocap.files import write_atomically

_FLOAT, _BYTE, _SHORT = 5126, 5121, 5123  # component types
_ARRAY, _ELEMENTS = 34962, 34963  # buffer targets
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # chunk types
_SKIN = (217, 217, 217)  # RGB of the middle of the body


def write_glb(path: Path, track: Track) -> None:
    """Write a track as GLB, atomically.

    Raises InputError for a track without skeleton or whose times do not increase, and as
    `egocap.files.disk_errors`.
    """
    if track.offsets is None:
        raise InputError("the track does not hold its skeleton", valid="a track of schema 2")
    write_atomically(path, glb_bytes(evenly(track)))


def glb_bytes(track: Track) -> bytes:
    """Content of the file of an evenly timed track."""
    root = joint_tree(np.asarray(track.offsets))
    joints = list(walk_tree(root))
    file = _Buffer()
    meshes = [mesh for i, joint in enumerate(joints) for mesh in _bones(joint, i, joints)]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "EgoCap"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(joints)]}],
        "nodes": [*_nodes(joints), {"name": "Figure", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "Figure", "primitives": [_primitive(file, joined(meshes))]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "skins": [_skin(file, joints)],
        "animations": [_animation(file, track, joints)],
    }
    document |= {"accessors": file.accessors, "bufferViews": file.views,
                 "buffers": [{"byteLength": len(file.content)}]}  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = _chunk(_JSON, text) + _chunk(_BINARY, bytes(file.content))
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


class _Buffer:
    """The binary chunk with its views and accessors."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Array, kind: int, target: int | None = None, **more: Any) -> int:
        """Append rows of values; return the index of their accessor."""
        dtype = {_FLOAT: "<f4", _BYTE: "u1", _SHORT: "<u2"}[kind]
        rows = np.ascontiguousarray(values, dtype)
        rows = rows.reshape(len(rows), -1)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.content)}
        view |= {"byteLength": rows.nbytes} | ({} if target is None else {"target": target})
        self.content += rows.tobytes()
        self.content += bytes(-len(self.content) % 4)
        self.views.append(view)
        self.accessors.append({
            "bufferView": len(self.views) - 1, "componentType": kind, "count": len(rows),
            "type": _TYPES[rows.shape[1]], **more,
        })  # fmt: skip
        return len(self.accessors) - 1


def _bones(joint: BvhJoint, index: int, joints: list[BvhJoint]) -> list[Mesh]:
    """Ellipsoids from a joint to its children and to its end, in the rest pose of the file."""
    start = _rest_places(joints)[index]
    tips = [child.offset for child in joint.children] + ([] if joint.end is None else [joint.end])
    colour = side_colour(joint.body, _SKIN)
    return [bone_mesh(start, TO_FILE @ tip, joint.body, index, colour) for tip in tips]


def _rest_places(joints: list[BvhJoint]) -> Float[Array, "N 3"]:
    """Places of the joints in the rest pose, file axes, metres."""
    place = {id(joints[0]): np.zeros(3)}
    for joint in joints:
        for child in joint.children:
            place[id(child)] = place[id(joint)] + TO_FILE @ child.offset
    return np.array([place[id(joint)] for joint in joints])


def _nodes(joints: list[BvhJoint]) -> list[dict[str, Any]]:
    index = {id(joint): i for i, joint in enumerate(joints)}
    nodes = []
    for joint in joints:
        node: dict[str, Any] = {
            "name": joint.name,
            "translation": (TO_FILE @ joint.offset).tolist(),
        }
        if joint.children:
            node["children"] = [index[id(child)] for child in joint.children]
        nodes.append(node)
    return nodes


def _primitive(file: _Buffer, mesh: Mesh) -> dict[str, Any]:
    count = len(mesh.vertices)
    bones, weights = np.zeros((count, 4)), np.zeros((count, 4))
    bones[:, 0], weights[:, 0] = mesh.bone, 1.0
    colours = np.column_stack([mesh.colour, np.full(count, 255)])
    low, high = mesh.vertices.min(0).tolist(), mesh.vertices.max(0).tolist()
    return {
        "attributes": {
            "POSITION": file.add(mesh.vertices, _FLOAT, _ARRAY, min=low, max=high),
            "NORMAL": file.add(mesh.normals, _FLOAT, _ARRAY),
            "COLOR_0": file.add(colours, _BYTE, _ARRAY, normalized=True),
            "JOINTS_0": file.add(bones, _BYTE, _ARRAY),
            "WEIGHTS_0": file.add(weights, _FLOAT, _ARRAY),
        },
        "indices": file.add(mesh.faces.reshape(-1, 1), _SHORT, _ELEMENTS),
        "material": 0,
    }


def _skin(file: _Buffer, joints: list[BvhJoint]) -> dict[str, Any]:
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    inverse[:, 3, :3] = -_rest_places(joints)  # matrices are stored column by column
    return {
        "joints": list(range(len(joints))), "skeleton": 0,
        "inverseBindMatrices": file.add(inverse, _FLOAT),
    }  # fmt: skip


def _animation(file: _Buffer, track: Track, joints: list[BvhJoint]) -> dict[str, Any]:
    times = track.times - track.times[0]
    clock = file.add(times[:, None], _FLOAT, min=[0.0], max=[float(np.float32(times[-1]))])
    world = body_rotations(track)
    parent = {id(child): joint for joint in joints for child in joint.children}
    tracks = [(0, "translation", root_position(track))]
    for i, joint in enumerate(joints):
        above, R = parent.get(id(joint)), world[joint.body]
        local = R if above is None else np.swapaxes(world[above.body], -1, -2) @ R
        tracks.append((i, "rotation", _quaternions(TO_FILE @ local @ TO_FILE.T)))
    return {
        "name": "Motion",
        "samplers": [{"input": clock, "output": file.add(v, _FLOAT)} for _, _, v in tracks],
        "channels": [
            {"sampler": k, "target": {"node": node, "path": path}}
            for k, (node, path, _) in enumerate(tracks)
        ],
    }


def _quaternions(R: Float[Array, "T 3 3"]) -> Float[Array, "T 4"]:
    """Quaternions (x, y, z, w), each on the side of the one before: viewers interpolate them."""
    from scipy.spatial.transform import Rotation

    q = Rotation.from_matrix(R).as_quat()
    turns = np.sign((q[1:] * q[:-1]).sum(1))
    return q * np.concatenate([[1.0], np.cumprod(np.where(turns < 0, -1.0, 1.0))])[:, None]


def _chunk(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", len(content), kind) + content
