"""Every kind of thing by name, and the making of a scene's things."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from egocap.errors import InputError
from egocap_sim.assets.mesh import AnimatedActor
from egocap_sim.props.balls import basketball, juggled
from egocap_sim.props.bicycle import bicycle
from egocap_sim.props.furnishing import chair, counter, desk, sofa, table
from egocap_sim.props.handheld import cup, newspaper, phone
from egocap_sim.props.performance import Performance
from egocap_sim.props.staircase import staircase
from egocap_sim.scene.config import ThingTable

Maker = Callable[[ThingTable, Performance, np.random.Generator], list[AnimatedActor]]


@dataclass(frozen=True)
class Kind:
    """How a kind of thing is made, and the motion that it needs, if any."""

    make: Maker
    motion: str | None = None
    held: bool = False  # in one hand


KINDS: dict[str, Kind] = {
    "ball": Kind(basketball, "dribble"),
    "bicycle": Kind(bicycle, "cycle"),
    "juggling_balls": Kind(juggled, "juggle"),
    "phone": Kind(phone, held=True),
    "cup": Kind(cup, held=True),
    "newspaper": Kind(newspaper, "hold"),
    "stairs": Kind(staircase, "stairs"),
    "table": Kind(table),
    "desk": Kind(desk),
    "counter": Kind(counter),
    "chair": Kind(chair),
    "sofa": Kind(sofa),
}


def check_prop(thing: ThingTable, motion: str | None) -> None:
    """Raise InputError for an unknown kind, a motion that does not go with it, or unused keys."""
    if thing.kind not in KINDS:
        raise InputError(f"unknown kind '{thing.kind}'", valid=KINDS)
    kind = KINDS[thing.kind]
    if kind.motion is not None and kind.motion != motion:
        raise InputError(f"a {thing.kind} needs the motion '{kind.motion}', not '{motion}'")
    if thing.hand is not None and not kind.held:
        raise InputError(f"a {thing.kind} is not held in a hand", valid="no 'hand'")


def make_prop(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """The actors of a thing at every frame."""
    return KINDS[thing.kind].make(thing, performance, rng)
