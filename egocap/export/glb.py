"""A track as GLB (binary glTF 2.0): the skinned figure with its animation.

Rotations and the place of the hips are keyframes of every frame.

Source: Khronos Group, glTF 2.0 Specification.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from egocap.data.track import Track
from egocap.export.ellipsoid import Mesh
from egocap.export.figure import Figure, animated_figure
from egocap.files import write_atomically

_FLOAT, _BYTE, _SHORT = 5126, 5121, 5123  # component types
_ARRAY, _ELEMENTS = 34962, 34963  # buffer targets
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942  # chunk types


def write_glb(path: Path, track: Track) -> None:
    """Write a track as GLB, atomically.

    Raises InputError as `animated_figure`, and as `egocap.files.disk_errors`.
    """
    write_atomically(path, glb_bytes(animated_figure(track)))


def glb_bytes(figure: Figure) -> bytes:
    """Content of the file."""
    file = _Buffer()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "EgoCap"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(figure.joints)]}],
        "nodes": [*_nodes(figure), {"name": "Figure", "mesh": 0, "skin": 0}],
        "meshes": [{"name": "Figure", "primitives": [_primitive(file, figure.mesh)]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "skins": [_skin(file, figure)],
        "animations": [_animation(file, figure)],
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


def _nodes(figure: Figure) -> list[dict[str, Any]]:
    nodes = []
    for i, joint in enumerate(figure.joints):
        node = {"name": joint.name, "translation": figure.offsets[i].tolist()}
        children = [k for k, parent in enumerate(figure.parents) if parent == i]
        nodes.append(node | ({"children": children} if children else {}))
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


def _skin(file: _Buffer, figure: Figure) -> dict[str, Any]:
    inverse = np.tile(np.eye(4), (len(figure.joints), 1, 1))
    inverse[:, 3, :3] = -figure.rest  # matrices are stored column by column
    return {
        "joints": list(range(len(figure.joints))), "skeleton": 0,
        "inverseBindMatrices": file.add(inverse, _FLOAT),
    }  # fmt: skip


def _animation(file: _Buffer, figure: Figure) -> dict[str, Any]:
    times = figure.times
    clock = file.add(times[:, None], _FLOAT, min=[0.0], max=[float(np.float32(times[-1]))])
    turns = enumerate(figure.quaternions.swapaxes(0, 1))
    tracks = [(0, "translation", figure.hips), *((i, "rotation", q) for i, q in turns)]
    return {
        "name": "Motion",
        "samplers": [{"input": clock, "output": file.add(v, _FLOAT)} for _, _, v in tracks],
        "channels": [
            {"sampler": k, "target": {"node": node, "path": path}}
            for k, (node, path, _) in enumerate(tracks)
        ],
    }


def _chunk(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", len(content), kind) + content
