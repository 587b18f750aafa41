"""A track as USD, in its text form (.usda): the skinned figure with its skeleton's animation.

Source: OpenUSD documentation, "UsdSkel: Schema Reference" and "Usda File Format".
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from egocap.data.track import Track
from egocap.export.figure import Figure, animated_figure
from egocap.files import write_atomically

_API = '(prepend apiSchemas = ["SkelBindingAPI"])'


def write_usd(path: Path, track: Track) -> None:
    """Write a track as USD text, atomically.

    Raises InputError as `animated_figure`, and as `egocap.files.disk_errors`.
    """
    write_atomically(path, usd_text(animated_figure(track)).encode())


def usd_text(figure: Figure) -> str:
    """Content of the file. A time code is a frame."""
    last = len(figure.times) - 1
    rate = last / figure.times[-1] if last else 30.0
    return f"""#usda 1.0
(
    defaultPrim = "Figure"
    doc = "EgoCap"
    metersPerUnit = 1
    upAxis = "Y"
    startTimeCode = 0
    endTimeCode = {last}
    framesPerSecond = {rate:.9g}
    timeCodesPerSecond = {rate:.9g}
)

def SkelRoot "Figure" {_API}
{{
{_skeleton(figure)}
{_animation(figure)}
{_mesh(figure)}
}}
"""


def _skeleton(figure: Figure) -> str:
    return f"""    def Skeleton "Skeleton" {_API}
    {{
        uniform token[] joints = {_joints(figure)}
        uniform matrix4d[] bindTransforms = {_matrices(figure.rest)}
        uniform matrix4d[] restTransforms = {_matrices(figure.offsets)}
        rel skel:animationSource = </Figure/Motion>
    }}
"""


def _animation(figure: Figure) -> str:
    rotations, places = [], []
    for frame, q in enumerate(figure.quaternions):
        offsets = np.concatenate([figure.hips[frame, None], figure.offsets[1:]])
        places.append(f"            {frame}: {_tuples(offsets)},")
        rotations.append(f"            {frame}: {_tuples(q[:, [3, 0, 1, 2]])},")
    ones = _tuples(np.ones((len(figure.joints), 3)))
    return "\n".join([
        '    def SkelAnimation "Motion"', "    {",
        f"        uniform token[] joints = {_joints(figure)}",
        f"        half3[] scales = {ones}",
        "        float3[] translations.timeSamples = {", *places, "        }",
        "        quatf[] rotations.timeSamples = {", *rotations, "        }",
        "    }", "",
    ])  # fmt: skip


def _mesh(figure: Figure) -> str:
    mesh = figure.mesh
    skin = '(elementSize = 1; interpolation = "vertex")'
    per_vertex = '(interpolation = "vertex")'
    return f"""    def Mesh "Body" {_API}
    {{
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = {_list(["3"] * len(mesh.faces))}
        int[] faceVertexIndices = {_list(map(str, mesh.faces.ravel()))}
        point3f[] points = {_tuples(mesh.vertices)}
        normal3f[] normals = {_tuples(mesh.normals)} {per_vertex}
        color3f[] primvars:displayColor = {_tuples(_linear(mesh.colour))} {per_vertex}
        int[] primvars:skel:jointIndices = {_list(map(str, mesh.bone))} {skin}
        float[] primvars:skel:jointWeights = {_list(["1"] * len(mesh.bone))} {skin}
        matrix4d primvars:skel:geomBindTransform = {_matrix(np.zeros(3))}
        rel skel:skeleton = </Figure/Skeleton>
    }}"""


def _joints(figure: Figure) -> str:
    paths: list[str] = []
    for joint, parent in zip(figure.joints, figure.parents, strict=True):
        paths.append(joint.name if parent < 0 else f"{paths[parent]}/{joint.name}")
    return _list(f'"{path}"' for path in paths)


def _matrices(places: Array) -> str:
    return _list(_matrix(place) for place in places)


def _matrix(place: Array) -> str:
    """A translation; vectors are rows."""
    x, y, z = place
    return f"((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), ({x:.6g}, {y:.6g}, {z:.6g}, 1))"


def _tuples(rows: Array) -> str:
    return _list(f"({', '.join(f'{value:.6g}' for value in row)})" for row in rows)


def _list(items: Iterable[str]) -> str:
    return f"[{', '.join(items)}]"


def _linear(colour: Array) -> Array:
    """Linear RGB of sRGB, as USD's colours are (IEC 61966-2-1)."""
    c = colour / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
