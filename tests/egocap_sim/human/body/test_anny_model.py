"""Bare people: heights, proportions, joints inside the body, weights."""

import numpy as np
import pytest

from egocap_sim.core.bodies import BODIES, INDEX, LABEL_BODY, PARENTS
from egocap_sim.human.body.anny_model import anatomy, bare_body, landmarks
from egocap_sim.human.body.phenotype import Phenotype


def winding_number(vertices, faces, point):
    """How often a surface surrounds a point (van Oosterom and Strackee 1983)."""
    a, b, c = (vertices[faces[:, i]] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)  # noqa: E731
    solid = 2 * np.arctan2(
        dot(a, np.cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    )
    return solid.sum() / (4 * np.pi)


@pytest.mark.parametrize("gender", [0.0, 1.0])
@pytest.mark.parametrize("height", [1.40, 1.50, 1.75, 2.00, 2.10])
def test_requested_height_is_reached(gender, height):
    body = bare_body(Phenotype(gender=gender), height)
    assert body.height_m == pytest.approx(height, abs=0.002)
    assert np.ptp(body.vertices[:, 2]) == pytest.approx(height, abs=0.002)
    assert body.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
    assert 0.3 <= body.phenotype.height <= 0.7


@pytest.mark.parametrize(
    "shape", [Phenotype(gender=0), Phenotype(gender=1, weight=0.9), Phenotype(muscle=0.9, age=0.9)]
)
def test_joints_are_inside_the_body_in_anatomical_order(shape):
    body = bare_body(shape, 1.75)
    faces = anatomy().faces
    for name, joint in zip(BODIES, body.joints, strict=True):
        assert winding_number(body.vertices, faces, joint) > 0.9, name
    assert abs(winding_number(body.vertices, faces, np.array([1.0, 1.0, 1.0]))) < 0.01
    # Shares of stature: Winter, Biomechanics and Motor Control of Human Movement, figure 4.1.
    share = {name: body.joints[i, 2] / body.height_m for name, i in INDEX.items()}
    for name, usual in (("l_thigh", 0.53), ("l_calf", 0.285), ("l_foot", 0.039)):
        assert share[name] == pytest.approx(usual, abs=0.02), name
    assert share["l_upperarm"] == pytest.approx(0.80, abs=0.025)
    assert share["head"] == pytest.approx(0.91, abs=0.02)


def test_faces_forward_and_left_is_left():
    body = bare_body(Phenotype(), 1.75)
    joints = {name: body.joints[i] for name, i in INDEX.items()}
    assert joints["l_toe"][0] > joints["l_foot"][0] + 0.1
    assert joints["l_hand"][1] > 0.2
    mirrored = [n.replace("l_", "?").replace("r_", "l_").replace("?", "r_") for n in BODIES]
    flip = body.joints[[INDEX.get(n, i) for i, n in enumerate(mirrored)]]
    sides = [i for i, n in enumerate(BODIES) if n[1] == "_"]
    assert flip[sides] * [1, -1, 1] == pytest.approx(body.joints[sides], abs=2e-3)


def test_landmarks_cover_the_labels():
    body = bare_body(Phenotype(), 1.75)
    marks = landmarks(body)
    assert marks.keys() == LABEL_BODY.keys()
    world = {k: body.joints[INDEX[LABEL_BODY[k]]] + v for k, v in marks.items()}
    for name, point in world.items():
        assert winding_number(body.vertices, anatomy().faces, point) > 0.9, name
    wrist, knuckle = body.joints[INDEX["l_hand"]], world["left_hand"]
    assert 0.07 < np.linalg.norm(knuckle - wrist) < 0.13
    assert world["left_foot"] == pytest.approx(body.joints[INDEX["l_toe"]])


def test_skin_weights():
    shape = anatomy()
    assert shape.weights.shape == shape.bones.shape == (len(shape.owner), 4)
    assert shape.weights.sum(1) == pytest.approx(1)
    assert shape.weights.min() >= 0
    assert (np.diff(shape.weights, axis=1) <= 1e-12).all()
    soft = (shape.weights[:, 1] > 0.1).mean()
    assert soft > 0.1  # joints bend over a width, not at a line
    first, second = shape.bones[shape.weights[:, 1] > 0.05][:, :2].T
    parent = np.array(PARENTS)
    near = (parent[first] == second) | (parent[second] == first) | (parent[first] == parent[second])
    assert near.mean() > 0.9  # neighbours share bodies


def test_volume_is_plausible():
    body = bare_body(Phenotype(gender=0), 1.75)
    assert 55 < body.volume_m3 * 1000 < 80
    heavy = bare_body(Phenotype(gender=0, weight=1.0, muscle=0.3), 1.75)
    assert heavy.volume_m3 > 1.15 * body.volume_m3
