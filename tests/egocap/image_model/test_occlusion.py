"""Occlusion by the body: who hides whom, and against quadrature along the ray."""

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Mount, Rig
from egocap.cameras.rig_files import load_rig
from egocap.image_model.body_kernel import gaussian_centres
from egocap.image_model.occlusion import (
    MARGINS,
    foreign_parts,
    joints_seen,
    optical_depths,
)
from egocap_sim.core.resources import rig_file


@pytest.fixture(scope="module")
def person():
    return Proportions.from_lengths(1.75)


@pytest.fixture(scope="module")
def body(person):
    return GaussianBody.from_proportions(person)


def test_every_label_has_parts_of_the_body(body):
    foreign = foreign_parts(body)
    for label, row in zip(LABELS, foreign, strict=True):
        own = {part for part, other in zip(body.parts, row, strict=True) if not other}
        assert own, label
        assert not any("left_" in part for part in own if label.startswith("right_"))


def test_depth_is_the_integral_along_the_ray(body, person):
    rng = np.random.default_rng(0)
    angles = 0.3 * rng.standard_normal((2, 37))
    joints = forward(person, angles)
    rig = load_rig(rig_file("egorig1"))
    depths = optical_depths(angles, joints, body, rig)
    centres, foreign = gaussian_centres(angles, body), foreign_parts(body)
    for label in ("left_wrist", "right_foot", "left_knee"):
        j = LABEL_INDEX[label]
        eye = rig.T_head_camera[1, :3, 3]
        length = np.linalg.norm(joints[1, j] - eye)
        ray = (joints[1, j] - eye) / length
        s = (np.arange(20_000) + 0.5) * length / 20_000
        points = eye + s[:, None] * ray
        total = 0.0
        for q in range(len(body.sigma)):
            end = length if foreign[j, q] else length - MARGINS[label.split("_")[1]]
            squared = np.sum((points - centres[1, q]) ** 2, axis=1)
            density = body.density[q] * np.exp(-0.5 * squared / body.sigma[q] ** 2)
            total += density[s < end].sum() * length / 20_000
        assert depths[1, 1, j] == pytest.approx(total, rel=0.01, abs=1e-3)


def test_seen_from_the_left_the_body_hides_the_right_hand(body, person):
    rest = np.zeros((1, 37))
    joints = forward(person, rest)
    hands = [LABEL_INDEX["left_hand"], LABEL_INDEX["right_hand"]]
    T = np.eye(4)
    T[:3, :3] = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])  # to the right
    T[:3, 3] = [0.0, 1.8, joints[0, hands[0], 2]]
    camera = load_rig(rig_file("egorig1")).cameras[0]
    rig = Rig("side", (Mount("side", camera, T),))
    assert joints_seen(rest, joints, body, rig)[0, 0, hands].tolist() == [True, False]
    # Nothing is seen by a camera that looks away.
    T[:3, :3] = T[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    away = Rig("away", (Mount("away", camera, T),))
    assert not joints_seen(rest, joints, body, away)[0, 0, hands].any()
