"""Stand-ins that need neither anny nor files."""

from __future__ import annotations

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.geometry import FORWARD, UP, axis_angle
from egocap_sim.assets.mesh import Actor
from egocap_sim.core.bodies import BODIES, INDEX, PARENT, PARENTS
from egocap_sim.human.body.person import Person
from egocap_sim.motion.kinematics import figure


def _rest_joints(toe_out: float) -> np.ndarray:
    """The standard figure with its arms 40 degrees out, elbows bent, feet turned out."""
    R = np.tile(np.eye(3), (len(BODIES), 1, 1))
    for side, out in (("l", 1.0), ("r", -1.0)):
        arm = axis_angle(FORWARD, out * np.deg2rad(40))
        R[INDEX[f"{side}_upperarm"]] = arm
        # An elbow bends the forearm to the front: a turn about the arm's own sideways axis.
        R[INDEX[f"{side}_forearm"]] = R[INDEX[f"{side}_hand"]] = arm @ axis_angle(
            np.array([0.0, -1.0, 0.0]), np.deg2rad(25)
        )
        R[INDEX[f"{side}_foot"]] = axis_angle(UP, out * toe_out)
    joints = figure.REST.copy()
    for b, parent in enumerate(PARENTS):
        if parent >= 0:
            joints[b] = joints[parent] + R[parent] @ (figure.REST[b] - figure.REST[parent])
    return joints


@pytest.fixture(scope="session")
def stand_in() -> Person:
    """A person of sticks: skin around the bones, flat feet, turned out by 0.15 rad."""
    toe_out = 0.15
    joints = _rest_joints(toe_out)
    rng = np.random.default_rng(0)
    skin, owner = [], []
    for body in BODIES:
        b = INDEX[body]
        child = [c for c in BODIES if PARENT.get(c) == body]
        end = joints[INDEX[child[0]]] if child else joints[b] + [0.0, 0.0, 0.1]
        if body.endswith(("foot", "toe")):
            turn = axis_angle(UP, toe_out if body[0] == "l" else -toe_out)
            back, front = (-0.05, 0.14) if body.endswith("foot") else (0.0, 0.06)
            points = rng.uniform([back, -0.04, -joints[b, 2]], [front, 0.04, 0.03 - joints[b, 2]],
                                 (60, 3)) @ turn.T + joints[b]  # fmt: skip
            points[:, 2] = np.maximum(points[:, 2], 0.0)
        else:
            along = joints[b] + rng.uniform(0, 1, (40, 1)) * (end - joints[b])
            ring = rng.normal(size=(40, 3))
            points = along + 0.06 * ring / np.linalg.norm(ring, axis=1, keepdims=True)
        skin.append(points)
        owner += [b] * len(points)
    landmarks = {name: np.zeros(3) for name in LABELS}
    for name, side in (("left_hand", "l"), ("right_hand", "r")):
        bone = joints[INDEX[f"{side}_hand"]] - joints[INDEX[f"{side}_forearm"]]
        landmarks[name] = 0.09 * bone / np.linalg.norm(bone)
    return Person(
        "stand-in", 1.75, 70.0, joints, landmarks, np.concatenate(skin),
        np.array(owner, float), Actor("stand-in", ()), {},
    )  # fmt: skip
