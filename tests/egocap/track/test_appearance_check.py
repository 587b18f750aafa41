"""Limbs that a detector found where the images show the background, and those that are there."""

import json
from dataclasses import replace

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.body.skeleton import DOF_INDEX, forward
from egocap.image_model.colour_measure import hsv_to_rgb
from egocap.image_model.image_rays import image_rays, ray_image
from egocap.image_model.model import ImageModel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import Modes, observe
from egocap.track.appearance_check import EVIDENCE, _reject, remove_rejected
from egocap.track.tracker import Tracker
from tests.egocap.conftest import make_motion

BLUE, GREY = np.array([0.6, 0.7, 0.6]), np.array([0.6, 0.02, 0.45])
ARM = [LABEL_INDEX[f"left_{name}"] for name in ("elbow", "wrist", "hand")]
WRONG = slice(30, 42)


@pytest.fixture(scope="module")
def scene():
    """A person in blue before grey, and the pictures."""
    motion = make_motion(frames=60, seed=4)
    rays = image_rays(motion.rig, 80, 64)
    body = GaussianBody.from_proportions(motion.person)
    model, pictures = ImageModel(body, rays), []
    for angles in motion.angles:
        covered = model.visibility(angles).sum(1)[:, None]
        rgb = covered * hsv_to_rgb(BLUE) + (1 - covered) * hsv_to_rgb(GREY)
        pictures.append([(255 * p).astype(np.uint8) for p in ray_image(rays, rgb, 0.0)])
    return motion, pictures


@pytest.fixture(scope="module")
def imagined(scene):
    """Detections of that motion, with the left arm found elsewhere, raised, for a while."""
    motion, _ = scene
    raised = motion.angles.copy()
    raised[:, DOF_INDEX["left_shoulder_raise"]] += 1.2
    there = motion.detect("simulated:2")
    elsewhere = replace(motion, joints=forward(motion.person, raised)).detect("simulated:2")
    found = replace(there, points=there.points.copy(), valid=there.valid.copy())
    for label in ARM:
        found.points[WRONG, :, label] = elsewhere.points[WRONG, :, label]
        found.valid[WRONG, :, label] = elsewhere.valid[WRONG, :, label]
    return found


def estimated(tracked):
    found = tracked.config["estimated"]
    assert isinstance(found, dict)
    return found


def wrist_error(motion, tracked):
    off = np.linalg.norm(tracked.joints_head - motion.joints, axis=-1)
    return off[WRONG, LABEL_INDEX["left_wrist"]].mean()


def test_an_arm_found_before_the_wall_is_not_believed(scene, imagined):
    motion, pictures = scene
    tracker = Tracker(motion.rig, motion.person)
    blind = tracker.track(imagined)
    checked = tracker.track(imagined, pictures.__getitem__)
    assert wrist_error(motion, blind) > 0.2
    assert wrist_error(motion, checked) < 0.5 * wrist_error(motion, blind)
    assert 10 <= estimated(checked)["rejected"] <= 2 * 3 * 18
    json.dumps(checked.config)
    config = TrackerConfig(appearance_check=False)
    told = Tracker(motion.rig, motion.person, config).track(imagined, pictures.__getitem__)
    np.testing.assert_array_equal(told.angles, blind.angles)


def test_what_is_there_stays(scene):
    motion, pictures = scene
    found = motion.detect("simulated:2")
    checked = Tracker(motion.rig, motion.person).track(found, pictures.__getitem__)
    assert estimated(checked)["rejected"] == 0
    np.testing.assert_array_equal(
        checked.angles, Tracker(motion.rig, motion.person).track(found).angles
    )


def test_a_black_view_denies_nothing(scene):
    motion, pictures = scene
    found = motion.detect("simulated:2")
    found = replace(found, valid=found.valid & np.array([True, False])[:, None])
    black = [(image, np.zeros_like(image)) for image, _ in pictures]
    checked = Tracker(motion.rig, motion.person).track(found, black.__getitem__)
    assert estimated(checked)["rejected"] == 0


def test_appearance_check_needs_interval_smoothing(scene, imagined):
    motion, pictures = scene
    config = TrackerConfig(smoothing="none")
    causal = Tracker(motion.rig, motion.person, config).track(imagined[:3], pictures.__getitem__)
    assert "rejected" not in estimated(causal)


def test_rejection_spreads_in_time_and_outwards():
    against = np.zeros((5, len(LABELS)))
    elbow, wrist, hand = ARM
    against[2, elbow] = 2 * EVIDENCE
    against[1, elbow] = 0.1 * EVIDENCE
    against[3, elbow] = -0.1 * EVIDENCE  # rather there
    against[1, wrist] = -2 * EVIDENCE  # there for sure
    expected = np.zeros_like(against, bool)
    expected[1:3, elbow] = expected[2, wrist] = expected[2, hand] = True
    np.testing.assert_array_equal(_reject(against), expected)


def test_what_led_there_is_dropped_and_what_did_not_stays(imagined, scene):
    motion, _ = scene
    observations = observe(imagined, motion.rig, motion.person, TrackerConfig())
    labels = np.zeros((60, len(LABELS)), bool)
    labels[25:35, ARM] = True
    left, dropped = remove_rejected(observations, labels, motion.joints)
    there = observations.weights > 0.0
    true = labels & (np.arange(60) < WRONG.start)[:, None]  # found where the joints are
    gone = there & (left.weights == 0.0)
    assert (gone <= true[:, None]).all() and dropped == gone.sum()
    assert gone.sum() > 0.8 * (there & true[:, None]).sum()
    assert (observations.weights[there] > 0.0).all()


def test_modes_are_dropped_by_their_own_places(imagined, scene):
    motion, _ = scene
    first = observe(imagined, motion.rig, motion.person, TrackerConfig())
    other = observe(motion.detect("simulated:0.5"), motion.rig, motion.person, TrackerConfig())
    rays, whiten, weights = (
        np.stack([getattr(places, name) for places in (first, other)], axis=1)
        for name in ("rays", "whiten", "weights")
    )
    modes = Modes(rays, whiten, weights, np.zeros_like(weights))
    labels = np.zeros((60, len(LABELS)), bool)
    labels[33, ARM] = True
    left, _ = remove_rejected(replace(first, modes=modes), labels, motion.joints)
    assert left.modes is not None
    assert left.modes.weights[33, 0][:, ARM].sum() == first.weights[33][:, ARM].sum()
    assert left.modes.weights[33, 1][:, ARM].sum() < 0.3 * other.weights[33][:, ARM].sum()
    np.testing.assert_array_equal(left.modes.weights[34], modes.weights[34])
