"""Bodies from detections of a made-up motion: right where it shows, honest where not."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import POINT_INDEX, forward
from egocap.errors import InputError
from egocap.fitting.body_prior import (
    BASIS,
    BodyPrior,
    length_spread,
    rest_offsets,
    to_components,
    to_proportions,
)
from egocap.fitting.bundle_adjustment import joint_derivatives
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_body import BODY_PASSES, choose_frames, first_seconds, fit_body
from egocap.fitting.fit_rig import RIG_PASSES, fit_rig

FEW = FitConfig(frames=30)
LIMBS = ("left_elbow", "left_wrist", "left_knee", "left_ankle")


def person():
    """Somebody whom the prior does not expect: long arms, short thighs."""
    prior = BodyPrior.for_height()
    mean = to_proportions(prior.mean).offsets.copy()
    for name, factor in {"elbow": 1.08, "wrist": 1.06, "knee": 0.92, "ankle": 1.05}.items():
        for side in ("left_", "right_"):
            mean[POINT_INDEX[side + name]] *= factor
    return Proportions(mean)


@pytest.fixture(scope="module")
def seen(motion):
    """Detections of 1 pixel of that person's bends, and the person."""
    body = person()
    return replace(motion, person=body, joints=forward(body, motion.angles)), body


@pytest.fixture(scope="module")
def fit(seen):
    moving, _ = seen
    return fit_body(moving.detect("simulated:1.0"), moving.rig, config=FEW)


def off(fit, body, name):
    i = POINT_INDEX[name]
    found, true = (np.linalg.norm(p.offsets[i]) for p in (fit.proportions, body))
    return found / true - 1.0


def test_limbs_come_out_within_three_percent(fit, seen):
    assert fit.converged
    assert max(abs(off(fit, seen[1], name)) for name in LIMBS) < 0.03
    assert all(fit.report()[name]["determined"] == "well" for name in ("left_elbow", "left_wrist"))


def test_one_camera_does_not_shorten_limbs(motion):
    """Depth is free then, and with it the limbs' length: the correction of the bias is limited."""
    body = to_proportions(BodyPrior.for_height().mean)
    moving = replace(motion, person=body, joints=forward(body, motion.angles))
    errors = []
    for seed in range(3):
        found = moving.detect("simulated:4.0", seed=seed)
        one = replace(found, valid=found.valid & (np.arange(2) == 0)[:, None])
        fit = fit_body(one, moving.rig, config=FEW)
        errors.append([off(fit, body, name) for name in LIMBS])
    assert abs(np.mean(errors)) < 0.03
    assert np.min(errors) > -0.06


def test_errors_are_within_their_stated_scatter(fit, seen):
    truth = np.linalg.norm(seen[1].offsets, axis=1)
    found = np.linalg.norm(fit.proportions.offsets, axis=1)
    there = truth > 1e-6
    assert (np.abs(found - truth)[there] / fit.std[there]).max() < 4.0
    assert (fit.std <= fit.prior_std + 1e-12).all()


def test_poses_come_along(fit, seen):
    moving, _ = seen
    joints = forward(fit.proportions, fit.angles)
    assert np.linalg.norm(joints - moving.joints[fit.frames], axis=-1).mean() < 0.02


def test_a_limb_without_detections_stays_at_the_prior(seen):
    moving, _ = seen
    found = moving.detect("simulated:1.0")
    blind = found.valid.copy()
    legs = [i for i, n in enumerate(LABELS) if n.split("_")[-1] in ("knee", "ankle", "foot", "hip")]
    blind[..., legs] = False
    points = found.points.copy()
    points[0, 0, 3] = np.nan
    fit = fit_body(replace(found, valid=blind, points=points), moving.rig, config=FEW)
    assert fit.report()["left_ankle"]["determined"] == "prior"
    assert fit.report()["left_elbow"]["determined"] == "well"
    assert not fit.seen[legs].any()
    shank = np.linalg.norm(rest_offsets(BodyPrior.for_height().mean)[POINT_INDEX["left_ankle"]])
    assert fit.proportions.bone_lengths["left_ankle"] == pytest.approx(shank, rel=0.1)
    assert np.isfinite(fit.std).all()


def test_a_stated_height_is_a_strong_prior(seen):
    tall, unknown = BodyPrior.for_height(1.95), BodyPrior.for_height()
    spread = [
        length_spread(p.mean, p.covariance)[POINT_INDEX["left_knee"]] for p in (tall, unknown)
    ]
    assert spread[0] < 0.75 * spread[1]
    usual = rest_offsets(unknown.mean)
    ratio = rest_offsets(tall.mean) / np.where(usual, usual, 1)
    np.testing.assert_allclose(ratio[usual != 0], 1.95 / 1.71)
    with pytest.raises(InputError, match="height"):
        fit_body(seen[0].detect("simulated:1.0"), seen[0].rig, height=17.8)


def test_derivatives_are_those_of_differences():
    rng = np.random.default_rng(0)
    c = BodyPrior.for_height().mean * rng.uniform(0.9, 1.1, len(BASIS))
    angles = rng.normal(0.0, 0.3, (2, 37))
    joints, by_angle, by_body = joint_derivatives(c, angles)
    np.testing.assert_allclose(joints, forward(to_proportions(c), angles), atol=1e-12)
    h = 1e-6
    for k in range(len(c)):
        up, down = (joint_derivatives(c + s * h * np.eye(len(c))[k], angles)[0] for s in (1, -1))
        np.testing.assert_allclose(by_body[..., k], (up - down) / (2 * h), atol=1e-8)
    for d in range(37):
        up, down = (joint_derivatives(c, angles + s * h * np.eye(37)[d])[0] for s in (1, -1))
        np.testing.assert_allclose(by_angle[..., d], (up - down) / (2 * h), atol=1e-8)


def test_components_are_those_of_a_symmetric_person():
    body = to_proportions(BodyPrior.for_height(1.8).mean)
    np.testing.assert_allclose(body.mirrored.offsets, body.offsets)
    np.testing.assert_allclose(to_components(body), BodyPrior.for_height(1.8).mean, atol=1e-12)


def test_the_fits_tell_of_all_their_work(seen):
    moving, _ = seen
    detections = moving.detect("simulated:1.0")
    for function, passes in ((fit_body, BODY_PASSES), (fit_rig, RIG_PASSES)):
        told = []
        function(detections, moving.rig, config=FEW, on_frames=told.append)
        assert sum(told) == passes * len(detections.times) and len(told) > 4


def test_nothing_to_fit_is_refused(seen):
    moving, _ = seen
    found = moving.detect("simulated:1.0")
    with pytest.raises(InputError, match="no detection"):
        fit_body(replace(found, valid=np.zeros_like(found.valid)), moving.rig)
    assert len(first_seconds(found, 1.0).times) == 31
    with pytest.raises(InputError, match="first"):
        first_seconds(found, 0.0)
    for wrong in ({"frames": 0}, {"iterations": 0}, {"tolerance": 1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            FitConfig(**wrong)


@pytest.mark.filterwarnings("error")
def test_a_window_without_detections_has_no_frames_to_choose():
    assert len(choose_frames(np.zeros((5, 37)), np.zeros(5, int), 3)) == 0
