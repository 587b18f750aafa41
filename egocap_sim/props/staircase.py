"""The staircase of the motion `stairs`: steps of stone or wood, a landing, and rails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from egocap.geometry import LEFT, axis_angle
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import box
from egocap_sim.core.ground_boxes import Slab
from egocap_sim.core.part_labels import ROOM
from egocap_sim.motion.generators.cycling import leg_scale
from egocap_sim.motion.generators.stairs import slabs
from egocap_sim.props.performance import Performance

_RAIL_M = 0.90  # over the treads' edges
_EDGE = 0.02  # metres by which a tread sticks out over its riser


def stairs(performance: Performance, rng: np.random.Generator) -> list[Mesh]:
    """Solid steps as large as the wearer's feet were laid on, with rails along both sides."""
    make = (textures.concrete, textures.wood, textures.planks)[int(rng.integers(3))]
    stone, edge = replace(make(rng), part=ROOM), textures.lacquer(rng)
    edge = replace(edge, part=ROOM, casts_shadow=False)
    steps = slabs(performance.parameters, leg_scale(performance.person))
    meshes: list[Mesh] = []
    for slab in steps:
        (x0, y0), (x1, y1), top = slab.low, slab.high, slab.top
        x, y, deep, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
        meshes += [
            box("step", (x, y, top / 2 - 0.02), (deep, wide, top - 0.04), stone),
            box("tread", (x - _EDGE / 2, y, top - 0.02), (deep + _EDGE, wide, 0.04), stone),
            box("nosing", (x0 - _EDGE + 0.015, y, top), (0.03, wide, 0.006), edge),
        ]
    return meshes + _rails(steps, rng)


def _rails(steps: Sequence[Slab], rng: np.random.Generator) -> list[Mesh]:
    """Posts and a handrail from post to post, on both sides."""
    steel, bar = textures.even(rng.uniform(0.15, 0.5)), textures.wood(rng)
    last = steps[-1]
    at = [(slab.low[0] + 0.05, slab.top) for slab in steps] + [(last.high[0] - 0.05, last.top)]
    meshes: list[Mesh] = []
    for y in (last.low[1] + 0.03, last.high[1] - 0.03):
        for x, z in at:
            meshes.append(box("post", (x, y, z + _RAIL_M / 2), (0.025, 0.025, _RAIL_M), steel))
        for (xa, za), (xb, zb) in pairwise(at):
            meshes.append(_sloped(bar, (xa, y, za + _RAIL_M), (xb, y, zb + _RAIL_M)))
    return meshes


def _sloped(material: Material, start: Sequence[float], end: Sequence[float]) -> Mesh:
    """A bar between two points of one y."""
    way = np.subtract(end, start)
    mesh = box("rail", (0, 0, 0), (float(np.linalg.norm(way)) + 0.03, 0.05, 0.04), material)
    R = axis_angle(LEFT, -float(np.arctan2(way[2], way[0])))
    return replace(mesh, vertices=mesh.vertices @ R.T + np.add(start, end) / 2)
