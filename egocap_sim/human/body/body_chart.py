"""Coordinates of the skin (along the arms, along the legs, above the neck) and body levels.

Garments are cut along these coordinates, so that a hem is a clean line around a limb independent
of the triangulation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy, skull_middle
from egocap_sim.human.body.triangles import vertex_normals

TORSO, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(5)  # pieces of a garment
ARMS, LEGS = (LEFT_ARM, RIGHT_ARM), (LEFT_LEG, RIGHT_LEG)
_BODIES = {
    **dict.fromkeys(ARMS, ("upperarm", "forearm", "hand")),
    **dict.fromkeys(LEGS, ("thigh", "calf", "foot", "toe")),
}
LIMBS: dict[int, tuple[str, ...]] = {
    piece: tuple(side + body for body in _BODIES[piece])
    for piece, side in ((LEFT_ARM, "l_"), (RIGHT_ARM, "r_"), (LEFT_LEG, "l_"), (RIGHT_LEG, "r_"))
}
"""Bodies of each limb from the root outward."""


@dataclass(frozen=True, eq=False)
class Skull:
    """Ellipsoid around the brain case, the base of hair, hats and headgear."""

    centre: Float[Array, "3"]  # world at rest
    half: Float[Array, "3"]  # half axes (m) forward, left and up, without ears and nose


@dataclass(frozen=True, eq=False)
class BodyChart:
    """A bare body with coordinates of every skin vertex, in metres.

    `along_arm` runs from the shoulder down the arm, `along_leg` from the hip down the leg (both 0
    elsewhere); `neck` is the height above a ring around the base of the neck, which is lower in
    front, and minus the distance to it on the shoulders and the chest.
    """

    body: BareBody
    piece: Int[Array, "N"]  # TORSO ... RIGHT_LEG
    along_arm: Float[Array, "N"]
    along_leg: Float[Array, "N"]
    neck: Float[Array, "N"]
    normals: Float[Array, "N 3"]
    on_arm: Bool[Array, "N"]
    on_leg: Bool[Array, "N"]
    elbow: float  # `along_arm` of the elbow and the wrist
    wrist: float
    knee: float  # `along_leg` of the knee and the ankle
    ankle: float
    crotch: float  # heights
    waist: float
    chest: float
    skull: Skull

    @property
    def vertices(self) -> Float[Array, "N 3"]:
        """The skin at rest."""
        return self.body.vertices

    def joint(self, body: str) -> Float[Array, "3"]:
        """Rest position of a body's joint."""
        return self.body.joints[INDEX[body]]


def make_chart(body: BareBody) -> BodyChart:
    """Compute the coordinates of a person's skin."""
    joints, vertices, piece = body.joints, body.vertices, _pieces()
    along = np.zeros(len(piece))
    for limb, names in LIMBS.items():
        on = piece == limb
        along[on] = _along(joints[[INDEX[name] for name in names[:3]]], vertices[on])
    on_arm, on_leg = np.isin(piece, ARMS), np.isin(piece, LEGS)
    middle = (np.abs(vertices[:, 1]) < 0.02) & (vertices[:, 2] > 0.3 * body.height_m)
    return BodyChart(
        body=body,
        piece=piece,
        along_arm=np.where(on_arm, along, 0.0),
        along_leg=np.where(on_leg, along, 0.0),
        neck=_above_neck(body),
        normals=vertex_normals(vertices, anatomy().faces),
        on_arm=on_arm,
        on_leg=on_leg,
        elbow=_length(joints, "l_upperarm", "l_forearm"),
        wrist=_length(joints, "l_upperarm", "l_forearm", "l_hand"),
        knee=_length(joints, "l_thigh", "l_calf"),
        ankle=_length(joints, "l_thigh", "l_calf", "l_foot"),
        crotch=float(vertices[middle, 2].min()),
        waist=float(joints[INDEX["spine"], 2] + 0.02 * body.height_m / 1.75),
        chest=float(joints[INDEX["chest"], 2] + 0.10),
        skull=_fit_skull(vertices[anatomy().owner == INDEX["head"]]),
    )


@cache
def _pieces() -> Int[Array, "N"]:
    piece = np.zeros(len(BODIES), int)
    for limb, names in LIMBS.items():
        piece[[INDEX[name] for name in names]] = limb
    return piece[anatomy().owner]


def _fit_skull(head: Float[Array, "N 3"]) -> Skull:
    middle = skull_middle(head)
    crown = head[head[:, 2] > middle[2] + 0.2 * (head[:, 2].max() - middle[2])]
    low, high = crown.min(0), crown.max(0)
    centre = np.array([(low[0] + high[0]) / 2, 0.0, middle[2]])
    return Skull(centre, np.array([*(high - low)[:2] / 2, high[2] - middle[2]]))


def _along(points: Float[Array, "3 3"], vertices: Float[Array, "N 3"]) -> Float[Array, "N"]:
    """Distance along a chain of two bones, continuous across their joint."""
    first, second = points[1] - points[0], points[2] - points[1]
    length = np.linalg.norm(first)
    upper = (vertices - points[0]) @ (first / length)
    lower = (vertices - points[1]) @ unit(second)
    return np.minimum(upper, length) + np.maximum(lower, 0.0)


def _above_neck(body: BareBody) -> Float[Array, "N"]:
    """Height above the ring of the neck; elsewhere, minus the distance to its disc."""
    neck, notch = body.joints[INDEX["neck"]], body.joints[INDEX["l_clavicle"]]
    back, front = neck + [-0.055, 0.0, 0.01], np.array([notch[0] + 0.04, 0.0, notch[2] + 0.01])
    up = unit(np.array([back[2] - front[2], 0.0, front[0] - back[0]]))
    offset = body.vertices - (back + front) / 2
    height = offset @ up
    beside = np.maximum(np.linalg.norm(offset - height[:, None] * up, axis=1) - 0.06, 0.0)
    beside[anatomy().owner == INDEX["head"]] = 0.0
    return np.where(height > 0, height - beside, -np.hypot(height, beside))


def _length(joints: Float[Array, "21 3"], *names: str) -> float:
    pairs = pairwise(joints[[INDEX[name] for name in names]])
    return float(sum(np.linalg.norm(b - a) for a, b in pairs))
