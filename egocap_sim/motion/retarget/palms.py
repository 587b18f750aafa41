"""Contact frame of a hand: centre and axes of its palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.person import Person
from egocap_sim.motion.retarget.retarget import canonical_offsets

_ALONG = 0.85  # from the wrist to the knuckle of the middle finger
_AROUND = 0.025  # metres: radius of the skin patch of a palm


@dataclass(frozen=True, eq=False)
class Palm:
    """A palm in its hand body's frame (parallel to the world at rest), metres."""

    body: int  # row of egocap_sim.core.bodies.BODIES
    centre: Float[Array, "3"]  # on the skin
    normal: Float[Array, "3"]  # unit, away from the hand
    fingers: Float[Array, "3"]  # unit, towards the fingertips
    thumb: Float[Array, "3"]  # unit, towards the thumb's side


def find_palm(person: Person, side: str) -> Palm:
    """The palm of side 'l' or 'r'."""
    body = INDEX[f"{side}_hand"]
    knuckle = person.landmarks["left_hand" if side == "l" else "right_hand"]
    # Hanging in the canonical pose the palms face each other and the thumbs forward.
    to_rest = canonical_offsets(person)[body].T
    fingers = unit(knuckle)
    inward = to_rest @ np.array([0.0, -1.0 if side == "l" else 1.0, 0.0])
    normal = unit(inward - (inward @ fingers) * fingers)
    thumb = np.cross(fingers, normal) * (1.0 if side == "l" else -1.0)
    thumb *= np.sign(thumb @ (to_rest @ np.array([1.0, 0.0, 0.0])))
    middle = _ALONG * knuckle
    skin = person.body_vertices[person.body_owner.astype(int) == body] - person.joints[body]
    beside = (skin - middle) - ((skin - middle) @ normal)[:, None] * normal
    near = np.linalg.norm(beside, axis=1) < _AROUND
    depth = float(((skin[near] - middle) @ normal).max()) if near.any() else 0.015
    return Palm(body, middle + depth * normal, normal, fingers, thumb)
