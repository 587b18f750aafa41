"""Furniture and stairs, fitted to the wearer's motion."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import LEFT, axis_angle, transform
from egocap_sim.assets import textures
from egocap_sim.assets.furniture import legs
from egocap_sim.assets.mesh import Material, Mesh
from egocap_sim.assets.primitives import box, cylinder, placed, sheet
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.ground_boxes import GroundBox
from egocap_sim.core.part_labels import FURNITURE, ROOM
from egocap_sim.human.body.limb_distances import limb_points
from egocap_sim.motion.generators.cycling import leg_scale
from egocap_sim.motion.generators.postures import SEAT_TO_PELVIS, SIT_BACK_M
from egocap_sim.motion.generators.stairs import stair_boxes
from egocap_sim.props.performance import Performance

_FLESH = 0.10  # metres of skin and cloth around `limb_points`
_FARTHEST = 1.3  # metres ahead, largest distance of a table
_RAIL_M = 0.90  # height above the edges of the treads
_EDGE = 0.02  # metres by which a tread overhangs its riser
_SEATED = 0.8  # share of the standing pelvis height below which the wearer sits

Rng = np.random.Generator

log = logging.getLogger(__name__)


def table(performance: Performance, rng: Rng) -> list[Mesh]:
    """A table in front of the wearer, with books."""
    wide, deep, high = rng.uniform(1.2, 1.6), rng.uniform(0.6, 0.8), rng.uniform(0.70, 0.76)
    front = _front(performance, wide, high - 0.12, high)
    meshes = _bare_table(rng, front, (deep, wide, high))
    for _ in range(int(rng.integers(2, 5))):
        size = (rng.uniform(0.12, 0.25), rng.uniform(0.1, 0.3), rng.uniform(0.015, 0.1))
        at = (front + rng.uniform(0.2, deep - 0.15), rng.uniform(-0.5, 0.5) * wide * 0.8)
        meshes.append(box("book", (*at, high + size[2] / 2), size, textures.lacquer(rng)))
    return meshes


def desk(performance: Performance, rng: Rng) -> list[Mesh]:
    """A desk under the hands and over the knees of a sitting wearer; otherwise a table."""
    bodies = performance.bodies
    if bodies[:, 0, 2, 3].max() > _SEATED * performance.person.joints[0, 2]:
        return table(performance, rng)
    hands = performance.palm_paths
    lowest = min(float(hand[:, 2].min()) for hand in hands)
    knees = float(bodies[:, [INDEX["l_calf"], INDEX["r_calf"]], 2, 3].max()) + _FLESH
    high = max(lowest - 0.01, knees + 0.03)
    trunk = bodies[:, [INDEX[b] for b in ("pelvis", "spine", "chest")], 0, 3]
    front = float(trunk.max()) + 0.16
    wide, deep = rng.uniform(1.3, 1.7), rng.uniform(0.65, 0.8)
    meshes = _bare_table(rng, front, (deep, wide, high))
    dark, paint = textures.even(0.12), textures.even(rng.uniform(0.2, 0.9))
    near, y = (float(k) for k in ((hands[0] + hands[1]).mean(0) / 2)[:2])
    lit = replace(textures.picture(rng), part=FURNITURE, glows=True)
    paper = replace(textures.even(0.93), part=FURNITURE)
    x = front + deep - 0.2
    corner, page = (x - 0.016, y + 0.265, high + 0.515), (near + 0.30, y - 0.12, high + 0.002)
    return [
        *meshes,
        box("keyboard", (near + 0.02, y, high + 0.008), (0.14, 0.42, 0.016), paint),
        box("foot", (x, y, high + 0.01), (0.2, 0.24, 0.02), dark),
        box("stand", (x + 0.03, y, high + 0.12), (0.03, 0.06, 0.22), dark),
        box("screen", (x, y, high + 0.36), (0.03, 0.56, 0.34), replace(dark, shininess=0.2)),
        sheet("picture", corner, (0, -0.53, 0), (0, 0, -0.31), lit),
        sheet("paper", page, (0, -0.21, 0), (-0.297, 0, 0), paper),
    ]


def counter(performance: Performance, rng: Rng) -> list[Mesh]:
    """A kitchen counter with pots in front of the wearer, under the hands."""
    points = limb_points(performance.bodies)
    hands = np.concatenate([path[:, 2] for path in performance.palm_paths])
    busy = hands[hands > 0.75]
    lowest = float(busy.min()) - 0.02 if len(busy) else 0.92
    high = float(np.clip(lowest, 0.75, 0.95))
    below = points[points[..., 2] < high - 0.1]
    front = float(below[:, 0].max()) + 0.03 if len(below) else 0.3
    if front > _FARTHEST:
        raise InputError("no room for a counter: the wearer walks around")
    wood, top = textures.wood(rng), replace(textures.lacquer(rng), shininess=0.3)
    wide, deep = rng.uniform(1.8, 2.4), 0.6
    x = front + deep / 2
    meshes = [
        box("counter", (x + 0.03, 0, high / 2 - 0.02), (deep - 0.06, wide, high - 0.04), wood),
        box("worktop", (x, 0.0, high - 0.02), (deep, wide, 0.04), top),
    ]
    for _ in range(5):
        at = (front + deep - 0.12, rng.uniform(-wide / 2 + 0.15, wide / 2 - 0.15), high)
        paint = replace(textures.lacquer(rng), shininess=0.3)
        r, tall = rng.uniform(0.04, 0.11), rng.uniform(0.05, 0.2)
        meshes.append(cylinder("pot", at, (0.8 * r, r), tall, paint))
    return meshes


def chair(performance: Performance, rng: Rng) -> list[Mesh]:
    """A chair where the wearer sits down."""
    at, yaw, seat = _seat(performance, "chair")
    cloth, frame = textures.cloth(rng), textures.wood(rng)
    size = (0.04, 0.04, seat - 0.05)
    meshes = [
        box("seat", (0, 0, seat - 0.025), (0.44, 0.46, 0.05), cloth),
        *legs("leg", (-0.2, 0.2), (-0.2, 0.2), size, frame, seat / 2 - 0.025),
        box("back", (-0.26, 0, seat + 0.27), (0.03, 0.44, 0.46), frame),
    ]
    return list(placed(meshes, at, yaw))


def sofa(performance: Performance, rng: Rng) -> list[Mesh]:
    """A sofa where the wearer sits down."""
    at, yaw, seat = _seat(performance, "sofa")
    cloth, wide = textures.cloth(rng), rng.uniform(1.7, 2.2)
    side = wide / 2 + 0.09
    meshes = [
        box("cushion", (-0.05, 0, seat - 0.08), (0.66, wide, 0.16), cloth),
        box("base", (-0.08, 0, (seat - 0.16) / 2), (0.6, wide, seat - 0.16), cloth),
        box("back", (-0.46, 0, 0.2 + seat / 2), (0.2, wide, 0.45 + seat), cloth),
        *legs("arm", (-0.12,), (-side, side), (0.7, 0.18, 0.62), cloth),
    ]
    return list(placed(meshes, at, yaw))


def _front(performance: Performance, wide: float, low: float, high: float) -> float:
    """Least x at which a top between two heights touches no limb in any frame."""
    points = limb_points(performance.bodies).reshape(-1, 3)
    level = (points[:, 2] > low - _FLESH) & (points[:, 2] < high + _FLESH)
    beside = np.abs(points[:, 1]) < wide / 2 + _FLESH
    near = points[level & beside, 0]
    front = float(near.max()) + _FLESH if len(near) else 0.3
    if front > _FARTHEST:
        raise InputError("no room for a table: the wearer walks around or reaches too far")
    return front


def _seat(performance: Performance, kind: str) -> tuple[Float[Array, "3"], float, float]:
    """Position on the floor, yaw and height of the seat, from the frame with the lowest pelvis."""
    person, pelvis = performance.person, performance.bodies[:, 0]
    skin = person.body_vertices[person.body_owner == INDEX["pelvis"]] - person.joints[0]
    k = int(pelvis[:, 2, 3].argmin())
    if pelvis[k, 2, 3] > _SEATED * person.joints[0, 2]:
        return _seat_behind(performance, kind, float(skin[:, 2].min()))
    lowest = float(transform(pelvis[k], skin)[:, 2].min())
    forward = pelvis[k, :2, 0]
    at = pelvis[k, :2, 3] + 0.05 * forward / np.linalg.norm(forward)
    return np.array([*at, 0.0]), float(np.arctan2(forward[1], forward[0])), lowest + 0.01


def _seat_behind(
    performance: Performance, kind: str, lowest: float
) -> tuple[Float[Array, "3"], float, float]:
    """As `_seat`, of frames that end before the wearer sits down: where the motion will sit.

    `lowest` is the height of the lowest skin of the pelvis above its joint.
    """
    if performance.motion.name != "sit":
        raise InputError(f"the wearer does not sit on the {kind}", valid="a motion with sitting")
    log.warning("the frames end before the wearer sits down on the %s", kind)
    scale, pelvis = leg_scale(performance.person), performance.bodies[0, 0]
    forward = pelvis[:2, 0] / np.linalg.norm(pelvis[:2, 0])
    at = pelvis[:2, 3] - (SIT_BACK_M * scale - 0.05) * forward
    yaw = float(np.arctan2(forward[1], forward[0]))
    pelvis_m = scale * (performance.parameters.seat + SEAT_TO_PELVIS)
    return np.array([*at, 0.0]), yaw, pelvis_m + lowest + 0.01


def _bare_table(rng: Rng, front: float, size: tuple[float, float, float]) -> list[Mesh]:
    """A table of a size (depth, width, height) with its front edge at x = `front`."""
    (deep, wide, high), wood = size, textures.wood(rng)
    top = box("top", (front + deep / 2, 0, high - 0.015), (deep, wide, 0.03), wood)
    x, y = (front + 0.05, front + (deep - 0.05)), (-wide / 2 + 0.06, wide / 2 - 0.06)
    return [top, *legs("leg", x, y, (0.05, 0.05, high - 0.03), wood, high / 2 - 0.015)]


def stairs(performance: Performance, rng: Rng) -> list[Mesh]:
    """The steps that the motion climbs, with rails along both sides."""
    make = (textures.concrete, textures.wood, textures.planks)[int(rng.integers(3))]
    stone, edge = replace(make(rng), part=ROOM), textures.lacquer(rng)
    edge = replace(edge, part=ROOM, casts_shadow=False)
    steps = stair_boxes(performance.parameters, leg_scale(performance.person))
    meshes: list[Mesh] = []
    for tread in steps:
        (x0, y0), (x1, y1), top = tread.low, tread.high, tread.top
        x, y, deep, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0
        meshes += [
            box("step", (x, y, top / 2 - 0.02), (deep, wide, top - 0.04), stone),
            box("tread", (x - _EDGE / 2, y, top - 0.02), (deep + _EDGE, wide, 0.04), stone),
            box("nosing", (x0 - _EDGE + 0.015, y, top), (0.03, wide, 0.006), edge),
        ]
    return meshes + _rails(steps, rng)


def _rails(steps: Sequence[GroundBox], rng: Rng) -> list[Mesh]:
    """Posts and a handrail from post to post, on both sides."""
    steel, bar = textures.even(rng.uniform(0.15, 0.5)), textures.wood(rng)
    last = steps[-1]
    at = [(tread.low[0] + 0.05, tread.top) for tread in steps] + [(last.high[0] - 0.05, last.top)]
    meshes: list[Mesh] = []
    for y in (last.low[1] + 0.03, last.high[1] - 0.03):
        for x, z in at:
            meshes.append(box("post", (x, y, z + _RAIL_M / 2), (0.025, 0.025, _RAIL_M), steel))
        for (xa, za), (xb, zb) in pairwise(at):
            meshes.append(_sloped(bar, (xa, y, za + _RAIL_M), (xb, y, zb + _RAIL_M)))
    return meshes


def _sloped(material: Material, start: Sequence[float], end: Sequence[float]) -> Mesh:
    """A rail between two points with equal y."""
    way = np.subtract(end, start)
    mesh = box("rail", (0, 0, 0), (float(np.linalg.norm(way)) + 0.03, 0.05, 0.04), material)
    R = axis_angle(LEFT, -float(np.arctan2(way[2], way[0])))
    return replace(mesh, vertices=mesh.vertices @ R.T + np.add(start, end) / 2)
