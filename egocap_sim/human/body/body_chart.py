"""Where on a person each point of the skin lies: along the arms, along the legs, how high.

Garments are cut and their fabric is laid along these coordinates, so that a hem is a clean line
around a limb however the triangles run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy
from egocap_sim.human.body.normals import vertex_normals

ARM = ("upperarm", "forearm", "hand")
LEG = ("thigh", "calf", "foot", "toe")
TORSO, LEFT_ARM, RIGHT_ARM, LEFT_LEG, RIGHT_LEG = range(5)  # pieces a garment is sewn from


@dataclass(frozen=True, eq=False)
class Chart:
    """Coordinates of every skin vertex, in metres.

    `arm` runs from the shoulder down the arm, `leg` from the hip down the leg (both 0 elsewhere);
    `neck` is the height above a ring around the base of the neck, lower in front, and minus the
    distance to it on the shoulders and the chest.
    """

    piece: Int[Array, "N"]  # TORSO ... RIGHT_LEG
    arm: Float[Array, "N"]
    leg: Float[Array, "N"]
    neck: Float[Array, "N"]
    elbow: float  # `arm` of the elbow, the wrist, `leg` of the knee and the ankle
    wrist: float
    knee: float
    ankle: float
    normals: Float[Array, "N 3"]


def make_chart(body: BareBody) -> Chart:
    """Lay the coordinates over a person."""
    joints = {name: body.joints[i] for name, i in INDEX.items()}
    piece = _pieces()
    arm, leg = np.zeros(len(piece)), np.zeros(len(piece))
    for prefix, arm_piece, leg_piece in (("l_", LEFT_ARM, LEFT_LEG), ("r_", RIGHT_ARM, RIGHT_LEG)):
        on_arm, on_leg = piece == arm_piece, piece == leg_piece
        points = [joints[prefix + b] for b in ("upperarm", "forearm", "hand")]
        arm[on_arm] = _along(points, body.vertices[on_arm])
        points = [joints[prefix + b] for b in ("thigh", "calf", "foot")]
        leg[on_leg] = _along(points, body.vertices[on_leg])
    return Chart(
        piece=piece,
        arm=arm,
        leg=leg,
        neck=_above_neck(body.vertices, joints),
        elbow=_length(joints, "l_upperarm", "l_forearm"),
        wrist=_length(joints, "l_upperarm", "l_forearm", "l_hand"),
        knee=_length(joints, "l_thigh", "l_calf"),
        ankle=_length(joints, "l_thigh", "l_calf", "l_foot"),
        normals=vertex_normals(body.vertices, anatomy().faces),
    )


@cache
def _pieces() -> Int[Array, "N"]:
    of_body = np.zeros(len(BODIES), int)
    for prefix, arm_piece, leg_piece in (("l_", LEFT_ARM, LEFT_LEG), ("r_", RIGHT_ARM, RIGHT_LEG)):
        of_body[[INDEX[prefix + b] for b in ARM]] = arm_piece
        of_body[[INDEX[prefix + b] for b in LEG]] = leg_piece
    return of_body[anatomy().owner]


def _along(points: list[Array], vertices: Float[Array, "N 3"]) -> Float[Array, "N"]:
    """Distance travelled along two bones in a row, continuous across the joint between them."""
    first, second = points[1] - points[0], points[2] - points[1]
    length = np.linalg.norm(first)
    upper = (vertices - points[0]) @ (first / length)
    lower = (vertices - points[1]) @ unit(second)
    return np.minimum(upper, length) + np.maximum(lower, 0.0)


def _above_neck(vertices: Float[Array, "N 3"], joints: dict[str, Array]) -> Float[Array, "N"]:
    """Height above the neck's ring; below and beside it, minus the distance to the ring's disc."""
    neck, notch = joints["neck"], joints["l_clavicle"]
    back, front = neck + [-0.055, 0.0, 0.01], np.array([notch[0] + 0.04, 0.0, notch[2] + 0.01])
    up = unit(np.array([back[2] - front[2], 0.0, front[0] - back[0]]))
    offset = vertices - (back + front) / 2
    height = offset @ up
    beside = np.maximum(np.linalg.norm(offset - height[:, None] * up, axis=1) - 0.06, 0.0)
    beside[anatomy().owner == INDEX["head"]] = 0.0
    return np.where(height > 0, height - beside, -np.hypot(height, beside))


def _length(joints: dict[str, Array], *names: str) -> float:
    return float(sum(np.linalg.norm(joints[b] - joints[a]) for a, b in pairwise(names)))
