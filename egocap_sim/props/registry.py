"""Kinds of props by name, and how to make them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from egocap.errors import InputError
from egocap_sim.assets.mesh import AnimatedActor, Mesh, resting
from egocap_sim.props.balls import basketball, juggling_balls
from egocap_sim.props.bicycle import bicycle
from egocap_sim.props.furnishing import chair, counter, desk, sofa, stairs, table
from egocap_sim.props.handheld import bag, controller, cup, newspaper, phone
from egocap_sim.props.performance import Performance
from egocap_sim.scene.config import ThingTable

Rng = np.random.Generator
Maker = Callable[[Performance, Rng], list[AnimatedActor]]


@dataclass(frozen=True)
class Kind:
    """The function that makes a kind of prop, and the motion that it requires, if any."""

    make: Maker
    motion: str | None = None


def at_rest(make: Callable[[Performance, Rng], list[Mesh]]) -> Maker:
    """Wrap a function that returns meshes into one that returns an actor at rest."""
    return lambda performance, rng: [
        resting(make.__name__, make(performance, rng), len(performance.times))
    ]


HELD: dict[str, Callable[[Performance, Rng, int], AnimatedActor]] = {
    "phone": phone, "cup": cup, "controller": controller, "bag": bag,
}  # fmt: skip
"""Kinds held in one hand: 0 left, 1 right."""
KINDS: dict[str, Kind] = {
    "ball": Kind(basketball, "dribble"),
    "bicycle": Kind(bicycle, "cycle"),
    "juggling_balls": Kind(juggling_balls, "juggle"),
    "newspaper": Kind(newspaper, "hold"),
    "stairs": Kind(at_rest(stairs), "stairs"),
    "table": Kind(at_rest(table)),
    "desk": Kind(at_rest(desk)),
    "counter": Kind(at_rest(counter)),
    "chair": Kind(at_rest(chair)),
    "sofa": Kind(at_rest(sofa)),
}


def check_prop(table: ThingTable, motion: str | None) -> None:
    """Raise InputError for an unknown kind, an unsuitable motion, or unused keys."""
    name = table.kind
    if name not in KINDS.keys() | HELD.keys():
        raise InputError(f"unknown kind '{name}'", valid=[*KINDS, *HELD])
    needed = KINDS[name].motion if name in KINDS else None
    if needed is not None and needed != motion:
        other = "a motion file" if motion is None else f"'{motion}'"
        raise InputError(f"a {name} needs the motion '{needed}', not {other}")
    if table.hand is not None and name not in HELD:
        raise InputError(f"a {name} is not held in a hand", valid="no 'hand'")


def make_prop(table: ThingTable, performance: Performance, rng: Rng) -> list[AnimatedActor]:
    """The actors of a prop at every frame."""
    if table.kind in HELD:
        return [HELD[table.kind](performance, rng, int(table.hand != "left"))]
    return KINDS[table.kind].make(performance, rng)
