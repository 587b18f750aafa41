"""Rays against a person of boxes: what a slab hides, what cloth may, and any pose of it."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap_eval.rig_design.ray_visibility import RayVisibility, _meets, make_surface
from egocap_sim.assets.mesh import Actor, Mesh
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.core.part_labels import wearer_part
from egocap_sim.human.body.person import Person
from egocap_sim.motion.kinematics import figure

UPRIGHT = np.eye(3)
LEFT_WRIST = LABEL_INDEX["left_wrist"]


def slab(name, centre, half, body):
    """A box carried by one body."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = np.array([
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ])  # fmt: skip
    weights = np.zeros((8, 4))
    weights[:, 0] = 1.0
    return Mesh(
        name, np.asarray(centre) + corners * half, faces, np.zeros((8, 2)),
        np.zeros((1, 1, 3), np.uint8), np.full(8, wearer_part(body), np.uint8),
        np.full((8, 4), INDEX[body]), weights,
    )  # fmt: skip


@pytest.fixture(scope="module")
def person():
    """Balls of skin, 5 cm in radius, about the joints of the standard figure."""
    rng, joints = np.random.default_rng(0), figure.REST
    ball = rng.normal(size=(len(BODIES), 160, 3))
    ball *= 0.05 / np.linalg.norm(ball, axis=-1, keepdims=True)
    skin = (joints[:, None] + ball).reshape(-1, 3)
    owner = np.repeat(np.arange(len(BODIES)), 160).astype(float)
    landmarks = {label: np.zeros(3) for label in LABELS}
    return Person("balls", 1.75, 70.0, joints, landmarks, skin, owner, Actor("balls", ()), {})


@pytest.fixture(scope="module")
def wrist(person):
    return person.joints[INDEX["l_hand"]]


def looking(person, *slabs):
    return RayVisibility(replace(person, actor=Actor("person", slabs)), cell_m=0.001)


def standing(person, turn=UPRIGHT, shift=(0.0, 0.0, 0.0)):
    """Every body as at rest, then moved as a whole: (1, 21, 4, 4)."""
    T = np.tile(np.eye(4), (1, len(BODIES), 1, 1))
    T[0, :, :3, :3] = turn
    T[0, :, :3, 3] = person.joints @ turn.T + shift
    return T


def test_foreign_slab_hides_and_own_does_not(person, wrist):
    eye = wrist + [1.0, 0.0, 0.0]
    between = wrist + [0.5, 0.0, 0.0]
    bare = looking(person, slab("far", wrist + [0.0, 5.0, 0.0], 0.1, "chest"))
    assert bare.shares(standing(person), eye[None])[0, 0, LEFT_WRIST] == pytest.approx(1.0)
    trunk = looking(person, slab("trunk", between, (0.02, 0.4, 0.4), "chest"))
    assert trunk.shares(standing(person), eye[None])[0, 0, LEFT_WRIST] == 0.0
    # From the other side the slab lies behind the wrist.
    behind = wrist - [1.0, 0.0, 0.0]
    assert trunk.shown(standing(person), behind[None])[0, 0, LEFT_WRIST]
    # A sleeve close to the skin is cloth; half a metre before it, it hides as well.
    sleeve = looking(person, slab("sleeve", wrist, (0.06, 0.06, 0.06), "l_forearm"))
    assert sleeve.shown(standing(person), eye[None])[0, 0, LEFT_WRIST]
    wing = looking(person, slab("wing", between, (0.02, 0.4, 0.4), "l_forearm"))
    assert not wing.shown(standing(person), eye[None])[0, 0, LEFT_WRIST]


def test_answers_move_with_the_body(person, wrist):
    """Turned and shifted together, person and eyes see the same; half a slab hides a share."""
    rays = looking(person, slab("half", wrist + [0.5, 0.0, 0.2], (0.02, 0.4, 0.2), "chest"))
    eyes = wrist + np.array([[1.0, 0.0, 0.0], [1.0, 0.1, -0.3], [0.2, -1.0, 0.4]])
    here = rays.shares(standing(person), eyes)
    assert 0.0 < here[0, 0, LEFT_WRIST] < 1.0
    c, s = np.cos(2.0), np.sin(2.0)
    turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    shift = np.array([0.3, -2.0, 1.0])
    there = rays.shares(standing(person, turn, shift), eyes @ turn.T + shift)
    np.testing.assert_allclose(there, here, atol=1e-12)


def test_clusters_hold_every_triangle_once(person, wrist):
    boxes = [slab("a", wrist, 0.3, "chest"), slab("b", wrist + 1.0, 0.3, "pelvis")]
    surface = make_surface(replace(person, actor=Actor("person", tuple(boxes))), 0.001)
    assert surface.starts[0] == 0 and surface.starts[-1] == len(surface.faces) == 24
    assert sorted(set(surface.parts)) == sorted({wearer_part("chest"), wearer_part("pelvis")})


def test_ray_meets_a_triangle_where_the_plane_says():
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(300):
        corners, eye = rng.normal(size=(3, 3)), 2.0 * rng.normal(size=3)
        ray = corners.mean(0) + 0.5 * rng.normal(size=3) - eye
        ray /= np.linalg.norm(ray)
        far = _meets(corners, np.arange(3), eye, *ray)
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        expected = normal @ (corners[0] - eye) / (normal @ ray)
        point = eye + expected * ray
        shares = np.linalg.lstsq(
            np.vstack([corners.T, np.ones(3)]), np.append(point, 1.0), rcond=None
        )[0]
        if np.all(shares >= 0.0) and expected > 1e-4:
            assert far == pytest.approx(expected, rel=1e-9)
            met += 1
        else:
            assert far == np.inf
    assert 50 < met < 250
