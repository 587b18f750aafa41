"""Wrong views, rigs, bodies and detections are named, and lower the confidence; sound ones are not.

Confidence is compared with the frequency of small errors, which nothing in the module sees.
"""

from dataclasses import replace

import numpy as np
import pytest

import egocap
from egocap.body.labels import MIRROR
from egocap.body.proportions import Proportions
from egocap.geometry import axis_angle
from egocap.track.consistency import check_consistency, limb_size, warning_of
from egocap.track.view_agreement import check_agreement, triangulate
from tests.egocap.conftest import make_motion


@pytest.fixture(scope="module")
def made():
    return make_motion(frames=60)


@pytest.fixture(scope="module")
def found(made):
    return made.detect("simulated:2.0", hidden=0.3)


def turned(rig, view, degrees, axis=(0.0, 1.0, 0.0)):
    mounts = list(rig.mounts)
    T = mounts[view].T_head_camera.copy()
    T[:3, :3] = axis_angle(np.array(axis), np.deg2rad(degrees)) @ T[:3, :3]
    mounts[view] = replace(mounts[view], T_head_camera=T)
    return replace(rig, mounts=tuple(mounts))


def reordered(found, axis, order):
    arrays = {name: np.take(getattr(found, name), order, axis)
              for name in ("points", "sigma", "confidence", "valid")}  # fmt: skip
    return replace(found, **arrays)


def test_sound_inputs_raise_no_warning(made, found):
    track = egocap.Tracker(made.rig, made.person).track(found)
    assert warning_of(track) is None
    told = track.config["consistency"]
    assert told["frames_in_doubt"] == 0.0
    assert 0.7 < told["residual"] < 1.3  # 1.18 of errors that the track has not been fitted to
    assert abs(told["size"] - 1.0) < 0.04
    within = (made.errors(track) < 0.05).mean()
    assert abs(track.confidence[:, 1:].mean() - within) < 0.1


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (lambda f, m: (reordered(f, 1, (1, 0)), m.rig, m.person), "views look exchanged"),
        (lambda f, m: (f, turned(m.rig, 1, 20.0), m.person), "rotated by about"),
        (lambda f, m: (f, m.rig, Proportions(0.8 * m.person.offsets)), "the limbs measure 12"),
        (lambda f, m: (replace(f, valid=np.zeros_like(f.valid)), m.rig, m.person), "hardly any"),
    ],
)
def test_wrong_inputs_are_named_and_confidence_follows_the_error(made, found, fault, named):
    given, rig, body = fault(found, made)
    track = egocap.Tracker(rig, body).track(given)
    assert named in warning_of(track)
    within = (made.errors(track) < 0.05).mean()
    assert track.confidence[:, 1:].mean() < within + 0.1


def test_random_detections_are_of_nothing(made, found):
    rng = np.random.default_rng(0)
    anywhere = replace(found, points=rng.random(found.points.shape) * (640, 512),
                       valid=np.ones_like(found.valid), confidence=np.full(found.valid.shape, 0.9),
                       sigma=np.full(found.valid.shape, 2.0))  # fmt: skip
    checked = check_consistency(made.joints, anywhere, made.rig, made.person)
    assert "detections of nothing" in checked.warning and checked.in_doubt == 1.0
    covariance = np.tile(1e-4 * np.eye(3), (60, 18, 1, 1))
    assert checked.confidences(made.joints, covariance)[:, 2:].mean() < 0.1


def test_half_of_the_frames_in_doubt_leaves_the_other_half(made, found):
    late = found.points + np.where(np.arange(60)[:, None, None, None] < 30, 0.0, 80.0)
    checked = check_consistency(made.joints, replace(found, points=late), made.rig, made.person)
    assert checked.in_doubt == pytest.approx(0.5)
    covariance = np.tile(1e-4 * np.eye(3), (60, 18, 1, 1))
    stated = checked.confidences(made.joints, covariance).mean(1)
    assert stated[:30].min() > 0.8 and stated[30:].max() < 0.4


def test_views_are_compared_where_too_little_is_seen_at_a_time_for_residuals(made):
    joint = np.random.default_rng(0).integers(1, 8, 60)[:, None, None]
    confidence = np.where(np.arange(18) == joint, 0.9, np.zeros((60, 2, 18)))
    sparse = replace(
        made.detect("simulated:2.0"),
        times=np.arange(60.0),
        valid=confidence > 0.0,
        confidence=confidence,
    )
    rig = turned(made.rig, 1, 12.0)
    checked = check_consistency(made.joints, sparse, rig, made.person)
    assert np.isnan(checked.residual).all() and checked.agreement.turned > 5.0
    assert np.isfinite(checked.spread).all() and checked.spread.min() > 0.05


def test_mirrored_labels_face_backwards(made, found):
    mirrored = made.joints[:, MIRROR]
    checked = check_consistency(mirrored, reordered(found, 2, MIRROR), made.rig, made.person)
    assert "left and right" in checked.warning


@pytest.mark.parametrize("degrees", [5.0, -12.0, 25.0])
@pytest.mark.parametrize("view", [0, 1])
def test_rotation_between_the_views_is_measured(made, view, degrees):
    exact = made.detect("simulated:0.5")
    assert np.isnan(check_agreement(exact, made.rig).turned)
    seen = check_agreement(exact, turned(made.rig, view, degrees))
    assert seen.turned == pytest.approx(abs(degrees), rel=0.15, abs=0.5)


def test_triangulation_finds_the_joints_and_the_size_of_the_limbs(made):
    exact = made.detect("simulated:0.1")
    joints, known = triangulate(exact, made.rig)
    assert known.mean() > 0.4
    assert np.median(np.linalg.norm(joints - made.joints, axis=-1)[known]) < 0.005
    larger = Proportions(1.25 * made.person.offsets)
    assert limb_size(exact, made.rig, made.person) == pytest.approx(1.0, abs=0.01)
    assert limb_size(exact, made.rig, larger) == pytest.approx(0.8, abs=0.01)


def test_elbows_and_knees_misplaced_along_the_limbs_leave_their_length(made):
    joints = made.joints.copy()
    for a, b, c in ((2, 3, 4), (6, 7, 8), (10, 11, 12), (14, 15, 16)):
        joints[:, b] += 0.12 * (made.joints[:, c] - made.joints[:, a])
    exact = made.detect("simulated:0.1")
    hips = np.isin(np.arange(18), (10, 14))  # hidden, as they mostly are: shins without thighs
    seen = replace(exact, points=np.moveaxis(made.rig.project(joints)[0], 0, 1),
                   valid=exact.valid & ~hips)  # fmt: skip
    assert limb_size(seen, made.rig, made.person) == pytest.approx(1.0, abs=0.04)


def test_one_view_alone_is_judged_by_its_residuals(made, found):
    rig = replace(made.rig, mounts=made.rig.mounts[:1])
    arrays = {name: getattr(found, name)[:, :1] for name in ("points", "sigma", "confidence",
                                                             "valid")}  # fmt: skip
    checked = check_consistency(made.joints, replace(found, **arrays), rig, made.person)
    assert checked.warning is None and np.isnan(checked.size)
    assert np.isnan(checked.agreement.as_given) and checked.to_dict()["size"] is None
