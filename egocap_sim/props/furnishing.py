"""Furniture that the wearer uses or that is in the way, fitted to what the wearer does."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import transform
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import AnimatedActor, Mesh
from egocap_sim.assets.primitives import box, cylinder, placed, sheet
from egocap_sim.core import part_labels
from egocap_sim.core.bodies import INDEX
from egocap_sim.crowd.bystanders import limb_points
from egocap_sim.props.performance import Performance
from egocap_sim.props.rigid_actor import resting
from egocap_sim.scene.config import ThingTable

_FLESH = 0.10  # metres of skin and cloth around the points inside limbs
_FARTHEST = 1.3  # metres ahead: farther off, a table is not in the way of anything


def table(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A table before the wearer."""
    wide, deep, high = rng.uniform(1.2, 1.6), rng.uniform(0.6, 0.8), rng.uniform(0.70, 0.76)
    front = _front(performance, wide, high - 0.12, high)
    return [resting("table", _table(rng, front, wide, deep, high), len(performance.times))]


def desk(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """Of someone who sits: a desk under the hands, the legs below it; else a table like others."""
    bodies = performance.bodies
    if bodies[:, 0, 2, 3].max() > 0.8 * performance.person.joints[0, 2]:
        return table(thing, performance, rng)
    hands = [performance.held(k, performance.palms[k].centre) for k in (0, 1)]
    lowest = min(float(hand[:, 2].min()) for hand in hands)
    knees = float(bodies[:, [INDEX["l_calf"], INDEX["r_calf"]], 2, 3].max()) + _FLESH
    high = max(lowest - 0.01, knees + 0.03)
    trunk = bodies[:, [INDEX[b] for b in ("pelvis", "spine", "chest")], 0, 3]
    front = float(trunk.max()) + 0.16
    wide, deep = rng.uniform(1.3, 1.7), rng.uniform(0.65, 0.8)
    meshes = _table(rng, front, wide, deep, high, books=False)
    dark, paint = (textures.even(np.full(3, v)).texture for v in (0.12, rng.uniform(0.2, 0.9)))
    middle = (hands[0] + hands[1]).mean(0) / 2
    screen = textures.picture(rng).texture
    x, y = front + deep - 0.2, float(middle[1])
    meshes += [
        box("keyboard", (middle[0] + 0.02, y, high + 0.008), (0.14, 0.42, 0.016), paint),
        box("foot", (x, y, high + 0.01), (0.2, 0.24, 0.02), dark),
        box("stand", (x + 0.03, y, high + 0.12), (0.03, 0.06, 0.22), dark),
        box("screen", (x, y, high + 0.36), (0.03, 0.56, 0.34), dark, shininess=0.2),
        sheet("picture", (x - 0.016, y + 0.265, high + 0.515), (0, -0.53, 0), (0, 0, -0.31),
              screen, part=part_labels.FURNITURE, glows=True),
    ]  # fmt: skip
    paper = textures.even(np.full(3, 0.93)).texture
    meshes.append(
        sheet("paper", (middle[0] + 0.30, y - 0.12, high + 0.002), (0, -0.21, 0), (-0.297, 0, 0),
              paper, part=part_labels.FURNITURE)
    )  # fmt: skip
    return [resting("desk", meshes, len(performance.times))]


def counter(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A kitchen counter before the wearer, with pans and bowls; as high as the hands allow."""
    points = limb_points(performance.bodies)
    hands = [performance.held(k, performance.palms[k].centre)[:, 2] for k in (0, 1)]
    busy = np.concatenate(hands)[np.concatenate(hands) > 0.75]
    lowest = float(busy.min()) - 0.02 if len(busy) else 0.92
    high = float(np.clip(lowest, 0.75, 0.95))
    below = points[points[..., 2] < high - 0.1]
    front = float(below[:, 0].max()) + 0.03 if len(below) else 0.3
    if front > _FARTHEST:
        raise InputError(f"there is no room for a {thing.kind}: the wearer walks about")
    wood, top = textures.wood(rng), textures.lacquer(rng)
    wide, deep = rng.uniform(1.8, 2.4), 0.6
    middle = (front + deep / 2, 0.0)
    meshes = [
        box("counter", (middle[0] + 0.03, 0, high / 2 - 0.02), (deep - 0.06, wide, high - 0.04),
            wood.texture, wood.tile),
        box("worktop", (*middle, high - 0.02), (deep, wide, 0.04), top.texture, shininess=0.3),
    ]  # fmt: skip
    for _ in range(5):
        y = rng.uniform(-wide / 2 + 0.15, wide / 2 - 0.15)
        paint = textures.lacquer(rng).texture
        r, tall = rng.uniform(0.04, 0.11), rng.uniform(0.05, 0.2)
        meshes.append(
            cylinder(
                "pot", (front + deep - 0.12, y, high), (0.8 * r, r), tall, paint, shininess=0.3
            )
        )
    return [resting("counter", meshes, len(performance.times))]


def chair(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A chair where the wearer sits down."""
    at, yaw, seat = _seat(thing, performance)
    cloth, frame = textures.cloth(rng), textures.wood(rng)
    meshes = [box("seat", (0, 0, seat - 0.025), (0.44, 0.46, 0.05), cloth.texture, cloth.tile)]
    for x in (-0.2, 0.2):
        for y in (-0.2, 0.2):
            meshes.append(box("leg", (x, y, seat / 2 - 0.025), (0.04, 0.04, seat - 0.05),
                              frame.texture))  # fmt: skip
    meshes.append(
        box("back", (-0.26, 0, seat + 0.27), (0.03, 0.44, 0.46), frame.texture, frame.tile)
    )
    return [resting("chair", placed(meshes, (*at, 0.0), yaw), len(performance.times))]


def sofa(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A sofa where the wearer sits down."""
    at, yaw, seat = _seat(thing, performance)
    cloth = textures.cloth(rng)
    wide = rng.uniform(1.7, 2.2)
    look = (cloth.texture, cloth.tile)
    meshes: list[Mesh] = [
        box("cushion", (-0.05, 0, seat - 0.08), (0.66, wide, 0.16), *look),
        box("base", (-0.08, 0, (seat - 0.16) / 2), (0.6, wide, seat - 0.16), *look),
        box("back", (-0.46, 0, 0.2 + seat / 2), (0.2, wide, 0.45 + seat), *look),
    ]
    for y in (-wide / 2 - 0.09, wide / 2 + 0.09):
        meshes.append(box("arm", (-0.12, y, 0.31), (0.7, 0.18, 0.62), *look))
    return [resting("sofa", placed(meshes, (*at, 0.0), yaw), len(performance.times))]


def _front(performance: Performance, wide: float, low: float, high: float) -> float:
    """Nearest x at which a top between two heights touches no limb in any frame."""
    points = limb_points(performance.bodies).reshape(-1, 3)
    level = (points[:, 2] > low - _FLESH) & (points[:, 2] < high + _FLESH)
    beside = np.abs(points[:, 1]) < wide / 2 + _FLESH
    near = points[level & beside, 0]
    front = float(near.max()) + _FLESH if len(near) else 0.3
    if front > _FARTHEST:
        raise InputError("there is no room for a table: the wearer walks or reaches about")
    return front


def _seat(thing: ThingTable, performance: Performance) -> tuple[Float[Array, "2"], float, float]:
    """Where, which way and how high the wearer sits: under the pelvis at its lowest."""
    person, pelvis = performance.person, performance.bodies[:, 0]
    k = int(pelvis[:, 2, 3].argmin())
    if pelvis[k, 2, 3] > 0.8 * person.joints[0, 2]:
        raise InputError(
            f"nobody sits on the {thing.kind}", valid="a motion in which one sits down"
        )
    owner = person.body_owner.astype(int)
    lowest = min(
        transform(performance.bodies[k, b], person.body_vertices[owner == b] - person.joints[b])[
            :, 2
        ].min()
        for b in (INDEX["pelvis"],)
    )
    forward = pelvis[k, :2, 0]
    yaw = float(np.arctan2(forward[1], forward[0]))
    return pelvis[k, :2, 3] + 0.05 * forward / np.linalg.norm(forward), yaw, float(lowest) + 0.01


def _table(
    rng: np.random.Generator,
    front: float,
    wide: float,
    deep: float,
    high: float,
    books: bool = True,
) -> list[Mesh]:
    wood = textures.wood(rng)
    x = front + deep / 2
    meshes = [box("top", (x, 0, high - 0.015), (deep, wide, 0.03), wood.texture, wood.tile)]
    for dx in (0.05, deep - 0.05):
        for y in (-wide / 2 + 0.06, wide / 2 - 0.06):
            leg = (front + dx, y, high / 2 - 0.015)
            meshes.append(box("leg", leg, (0.05, 0.05, high - 0.03), wood.texture, wood.tile))
    for _ in range(int(rng.integers(2, 5)) if books else 0):
        size = (rng.uniform(0.12, 0.25), rng.uniform(0.1, 0.3), rng.uniform(0.015, 0.1))
        at = (front + rng.uniform(0.2, deep - 0.15), rng.uniform(-0.5, 0.5) * wide * 0.8)
        paint = textures.lacquer(rng).texture
        meshes.append(box("book", (*at, high + size[2] / 2), size, paint))
    return meshes
