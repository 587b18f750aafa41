"""Detections with a learned detector's errors: sizes, guesses of hidden joints, episodes."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.rig_files import load_rig
from egocap.pose.pose_prior import load_posture
from egocap_eval.priors.guesses import guess_detections
from egocap_eval.priors.takes import Take
from egocap_eval.priors.tracks import LearningTrack, both_ways, track_take
from egocap_sim.core.resources import builtin_file


@pytest.fixture(scope="module")
def take():
    """Legs that swing."""
    from egocap.body.proportions import Proportions
    from egocap.body.skeleton import DOF_INDEX, forward

    t, person = np.arange(60) / 30.0, Proportions.from_lengths(1.75)
    angles = np.tile(load_posture().mean, (60, 1))
    for side, phase in (("left", 0.0), ("right", np.pi)):
        angles[:, DOF_INDEX[f"{side}_hip_flexion"]] += 0.4 * np.sin(2 * np.pi * t + phase)
    place = np.tile(np.eye(4), (60, 1, 1))
    place[:, 0, 3], place[:, 2, 3] = 1.2 * t, 1.6
    return Take("swing", angles, forward(person, angles), place, np.asarray(person.offsets))


def test_visible_joints_are_near_and_hidden_ones_are_guessed(take):
    rig = load_rig(builtin_file("rig", "egorig1")).resized(640, 512)
    errors, sure = [], []
    for seed in range(6):
        found = guess_detections(take, rig, np.random.default_rng(seed))
        true = np.moveaxis(rig.project(take.joints_head)[0], 0, 1)
        errors.append(np.linalg.norm(found.points - true, axis=-1))
        sure.append(found.confidence > 0.5)
    errors, sure = np.array(errors), np.array(sure)
    elbow = LABEL_INDEX["left_elbow"]
    ankles = [LABEL_INDEX["left_ankle"], LABEL_INDEX["right_ankle"]]
    assert np.nanmedian(errors[..., elbow][sure[..., elbow]]) < 5
    hidden = errors[..., ankles][~sure[..., ankles]]
    assert 3 < np.nanmedian(hidden) < 20
    assert np.array_equal(found.valid, np.isfinite(found.points).all(-1))


def test_tracks_of_takes_have_errors_like_those(take):
    track = track_take(take, np.random.default_rng(0))
    assert track.angles.shape == (60, 37) and track.std.shape == (60, 18)
    off = np.abs(track.angles - track.truth).mean()
    assert 0.005 < off < 0.3


def test_mirrored_twice_is_the_same(take):
    rng = np.random.default_rng(1)
    tracked = take.angles + 0.1 * rng.standard_normal(take.angles.shape)
    std = rng.random((60, 18))
    track = LearningTrack("a", tracked, std, take.angles, take.T_world_head, take.offsets)
    _, mirror = both_ways([track])
    back = mirror.mirrored
    for name in ("angles", "std", "truth", "T_world_head", "offsets"):
        assert np.allclose(getattr(back, name), getattr(track, name)), name
    from egocap.body.labels import MIRROR
    from egocap.body.skeleton import forward

    flipped = forward(track.person, track.truth)[:, MIRROR] * [1, -1, 1]
    assert np.allclose(forward(mirror.person, mirror.truth), flipped, atol=1e-9)
