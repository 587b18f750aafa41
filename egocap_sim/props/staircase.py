"""The staircase of the motion `stairs`: steps of stone or wood, a landing, and rails."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from egocap.geometry import LEFT, axis_angle
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import AnimatedActor, Mesh
from egocap_sim.assets.primitives import box
from egocap_sim.core import part_labels
from egocap_sim.motion.generators.cycling import leg_scale
from egocap_sim.motion.generators.stairs import slabs
from egocap_sim.props.performance import Performance
from egocap_sim.props.rigid_actor import resting
from egocap_sim.scene.config import ThingTable

_RAIL_M = 0.90  # over the treads' edges
_EDGE = 0.02  # metres by which a tread sticks out over its riser


def staircase(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """Solid steps as large as the wearer's feet were laid on, with rails along both sides."""
    make = (textures.concrete, textures.wood, textures.planks)[int(rng.integers(3))]
    stone, edge = make(rng), textures.lacquer(rng)
    steps = slabs(performance.parameters, leg_scale(performance.person))
    meshes: list[Mesh] = []
    for slab in steps:
        (x0, y0), (x1, y1) = slab.low, slab.high
        middle = ((x0 + x1) / 2, (y0 + y1) / 2)
        wide = (x1 - x0, y1 - y0)
        meshes.append(
            box("step", (*middle, slab.top / 2 - 0.02), (*wide, slab.top - 0.04),
                stone.texture, stone.tile, part=part_labels.ROOM)
        )  # fmt: skip
        meshes.append(
            box("tread", (middle[0] - _EDGE / 2, middle[1], slab.top - 0.02),
                (wide[0] + _EDGE, wide[1], 0.04), stone.texture, stone.tile, part=part_labels.ROOM)
        )  # fmt: skip
        meshes.append(
            box("nosing", (x0 - _EDGE + 0.015, middle[1], slab.top), (0.03, wide[1], 0.006),
                edge.texture, part=part_labels.ROOM, casts_shadow=False)
        )  # fmt: skip
    meshes += _rails(steps, rng)
    return [resting("stairs", meshes, len(performance.times))]


def _rails(steps, rng: np.random.Generator) -> list[Mesh]:
    """Posts and a handrail from post to post, on both sides."""
    steel = textures.even(np.full(3, rng.uniform(0.15, 0.5))).texture
    bar = textures.wood(rng).texture
    last = steps[-1]
    at = [(slab.low[0] + 0.05, slab.top) for slab in steps] + [(last.high[0] - 0.05, last.top)]
    meshes: list[Mesh] = []
    for y in (last.low[1] + 0.03, last.high[1] - 0.03):
        for x, z in at:
            meshes.append(box("post", (x, y, z + _RAIL_M / 2), (0.025, 0.025, _RAIL_M), steel))
        for (xa, za), (xb, zb) in pairwise(at):
            meshes.append(_sloped(bar, (xa, y, za + _RAIL_M), (xb, y, zb + _RAIL_M)))
    return meshes


def _sloped(texture, start, end) -> Mesh:
    """A bar between two points of one y."""
    way = np.subtract(end, start)
    length = float(np.linalg.norm(way))
    mesh = box("rail", (0, 0, 0), (length + 0.03, 0.05, 0.04), texture)
    R = axis_angle(LEFT, -float(np.arctan2(way[2], way[0])))
    return replace(mesh, vertices=mesh.vertices @ R.T + np.add(start, end) / 2)
