"""Points tracked over drawn pictures: a body of many colours before a room that turns."""

import numpy as np
import pytest

from egocap.appearance.surface_points import SurfacePoints, robust_rotation
from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import DOF_INDEX, JOINTS
from egocap.geometry import exponential
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.model import ImageModel
from tests.egocap.image_model.test_palette import PERSON, POSE, RIG

SIZE = (160, 128)
RAYS = image_rays(RIG, *SIZE)
COLOURS = np.random.default_rng(0).uniform((0.0, 0.4, 0.2), (1.0, 0.9, 0.9), (91, 3))
BODY = GaussianBody.from_proportions(PERSON).with_colour(COLOURS)
MODEL = ImageModel(BODY, RAYS)
WAVES = np.random.default_rng(1).normal(0.0, 12.0, (3, 8))
ELBOW = DOF_INDEX["right_elbow_flexion"]
STILL = np.eye(3)
TURN = exponential(np.deg2rad([0.5, -0.4, 1.5]))


def pictures(pose, room=STILL):
    """RGB images of the body before a room that has turned in the head frame."""
    seen = MODEL.visibility(pose)
    grey = 0.5 + 0.4 * np.sin(RAYS.direction @ room @ WAVES).mean(1)
    rgb = seen @ hsv_to_rgb(COLOURS) + (1.0 - seen.sum(1))[:, None] * grey[:, None]
    images = [(255 * np.clip(p, 0.0, 1.0)).astype(np.uint8) for p in ray_image(RAYS, rgb, 0.0)]
    return images, ray_image(RAYS, seen.sum(1), 0.0)


def bent(degrees):
    pose = POSE.copy()
    pose[ELBOW] += np.deg2rad(degrees)
    return pose


def started():
    points = SurfacePoints(RIG, BODY)
    images, opacity = pictures(POSE)
    assert points.follow(images, POSE) is None
    points.settle(POSE, opacity)
    return points


def elbow_found(points, start):
    """The elbow's angle that the points tell, by Gauss-Newton over that angle alone."""
    pose = start.copy()
    for _ in range(10):
        H, g = np.zeros((37, 37)), np.zeros(37)
        points.add(pose, H, g)
        pose[ELBOW] -= g[ELBOW] / H[ELBOW, ELBOW]
    return np.rad2deg(pose[ELBOW] - POSE[ELBOW])


def test_points_lie_on_the_body_and_fit_the_first_pose():
    points = started()
    assert len(points) > 100
    H, g = np.zeros((37, 37)), np.zeros(37)
    assert points.add(POSE, H, g) == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(g, 0.0, atol=1e-4)
    assert H[ELBOW, ELBOW] > 0.0
    assert H[DOF_INDEX["left_hip_flexion"], DOF_INDEX["left_hip_flexion"]] > 0.0
    arm = np.array([joint.name in ("right_elbow", "right_wrist") for joint in JOINTS])
    points.forget(arm)
    H = np.zeros((37, 37))
    points.add(POSE, H, g)
    assert H[ELBOW, ELBOW] == 0.0 and len(points) > 100


def test_a_bent_elbow_and_a_turned_room_are_found():
    points = started()
    images, opacity = pictures(bent(4.0), TURN)
    turn = points.follow(images, POSE)
    assert turn is not None
    assert np.rad2deg(np.arccos((np.trace(turn.T @ TURN) - 1.0) / 2.0)) < 0.2
    assert elbow_found(points, POSE) == pytest.approx(4.0, abs=0.8)
    points.settle(bent(4.0), opacity)
    images, _ = pictures(bent(8.0), TURN @ TURN)
    points.follow(images, bent(8.0))
    assert elbow_found(points, bent(4.0)) == pytest.approx(8.0, abs=2.0)  # drawn colours blend


def test_derivatives_are_those_of_the_energy():
    points = started()
    points.follow(pictures(bent(4.0))[0], POSE)
    rng = np.random.default_rng(2)
    pose = POSE + rng.normal(0.0, 0.02, 37)
    g = np.zeros(37)
    points.add(pose, np.zeros((37, 37)), g)

    def energy(at):
        return points.add(at, np.zeros((37, 37)), np.zeros(37))

    for _ in range(5):
        way = rng.normal(size=37)
        slope = (energy(pose + 1e-5 * way) - energy(pose - 1e-5 * way)) / 2e-5
        assert g @ way == pytest.approx(slope, rel=1e-3, abs=1e-4)


def test_points_on_the_background_lose_their_weight():
    """A room that turns behind a body that is said to be where it is not: its points slip off."""
    wrong = POSE.copy()
    wrong[DOF_INDEX["right_shoulder_raise"]] += np.deg2rad(50.0)
    points, room = SurfacePoints(RIG, BODY), np.eye(3)
    _, opacity = pictures(wrong)
    points.follow(pictures(POSE, room)[0], wrong)
    points.settle(wrong, opacity)
    H = np.zeros((37, 37))
    points.add(wrong, H, np.zeros(37))
    for _ in range(6):
        room = TURN @ room
        points.follow(pictures(POSE, room)[0], wrong)
        points.settle(wrong, opacity)
    later = np.zeros((37, 37))
    points.add(wrong, later, np.zeros(37))
    assert later[ELBOW, ELBOW] < 0.5 * H[ELBOW, ELBOW]


def test_a_still_picture_changes_nothing():
    points = started()
    count = len(points)
    images, opacity = pictures(POSE)
    turn = points.follow(images, POSE)
    assert turn is not None and np.allclose(turn, np.eye(3), atol=1e-3)
    points.settle(POSE, opacity)
    assert 0.9 * count < len(points) < 1.3 * count
    assert elbow_found(points, POSE) == pytest.approx(0.0, abs=0.2)


def test_a_rotation_is_found_among_outliers():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(60, 3))
    a /= np.linalg.norm(a, axis=1)[:, None]
    b = a @ TURN.T
    b[:15] = a[rng.permutation(15)]
    assert np.allclose(robust_rotation(a, b, 0.01), TURN, atol=2e-3)
