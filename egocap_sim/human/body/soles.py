"""Soles of a person's feet: one flat box under each foot body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import UP, axis_angle
from egocap_sim.core.bodies import FEET, INDEX
from egocap_sim.human.body.person import Person

_HALF_HEIGHT = 0.02  # metres; only the bottom face matters
_LOW = 0.06  # metres above the floor: skin below belongs to the sole
_TOE_LENGTH = 0.07  # metres, where a person has no toe vertices


@dataclass(frozen=True, eq=False)
class Sole:
    """A box under one foot body, its bottom on the floor when the person stands at rest."""

    body: str
    centre: Float[Array, "3"]  # in the body's frame, metres
    half: Float[Array, "3"]  # half edges, metres
    yaw: float  # rotation of the box about the vertical, radians

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """Orientation of the box in the body's frame."""
        return axis_angle(UP, self.yaw)

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """The bottom corners in the body's frame, metres."""
        signs = np.array([(1, 1, -1), (1, -1, -1), (-1, -1, -1), (-1, 1, -1)])
        return self.centre + (signs * self.half) @ self.rotation.T


def foot_yaw(person: Person, side: str) -> float:
    """Yaw of a foot at rest: angle from +x about z in radians; side 'l' or 'r'."""
    d = person.joints[INDEX[f"{side}_toe"]] - person.joints[INDEX[f"{side}_foot"]]
    return float(np.arctan2(d[1], d[0]))


def soles(person: Person) -> tuple[Sole, ...]:
    """The four sole boxes of a person, in the order of `egocap_sim.core.bodies.FEET`."""
    return tuple(_sole(person, body) for body in FEET)


def sole_points(
    person: Person, positions: Float[Array, "T B 3"], rotations: Float[Array, "T B 3 3"]
) -> Float[Array, "T 4 4 3"]:
    """World positions of every sole's bottom corners for posed bodies, axis 1 as `FEET`."""
    return sole_corners(soles(person), positions, rotations)


def sole_corners(
    boxes: Sequence[Sole], positions: Float[Array, "T B 3"], rotations: Float[Array, "T B 3 3"]
) -> Float[Array, "T S 4 3"]:
    """World positions of the bottom corners of given soles."""
    points = [
        sole.corners @ np.swapaxes(rotations[:, INDEX[sole.body]], -1, -2)
        + positions[:, None, INDEX[sole.body]]
        for sole in boxes
    ]
    return np.stack(points, 1)


def _sole(person: Person, body: str) -> Sole:
    side, part = body.split("_")
    yaw, joint = foot_yaw(person, side), person.joints[INDEX[body]]
    inward = axis_angle(UP, -yaw)  # world -> box axes
    ball = inward @ (person.joints[INDEX[f"{side}_toe"]] - joint)
    mine = person.body_owner == INDEX[f"{side}_foot"]
    if part == "toe":
        mine |= person.body_owner == INDEX[body]
    mine &= person.body_vertices[:, 2] < _LOW
    points = (person.body_vertices[mine] - joint) @ inward.T
    points = points[points[:, 0] <= ball[0]] if part == "foot" else points[points[:, 0] >= ball[0]]
    if len(points) < 3:
        points = ball + np.array([[0.0, -0.03, 0.0], [0.0, 0.03, 0.0], [_TOE_LENGTH, 0.0, 0.0]])
    low, high = np.percentile(points, (3, 97), axis=0)
    # The boxes of foot and toe meet under the ball of the foot.
    if part == "foot":
        high[0] = ball[0]
    else:
        low[0] = ball[0]
    centre, half = (low + high) / 2, (high - low) / 2
    centre[2], half[2] = _HALF_HEIGHT - joint[2], _HALF_HEIGHT
    return Sole(body, axis_angle(UP, yaw) @ centre, half, yaw)
