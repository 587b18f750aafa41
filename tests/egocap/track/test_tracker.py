"""The whole tracker: accuracy, gaps, garbage, and the record it leaves."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.data.detections import Detections
from egocap.data.track import load_track, save_track
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker
from tests.egocap.conftest import make_motion


def run(motion, detections, **settings):
    return Tracker(motion.rig, motion.person, TrackerConfig(**settings)).track(detections)


def test_exact_detections_give_the_pose(motion):
    found = motion.detect("simulated:0")
    result = run(motion, found)
    assert np.median(motion.errors(result)) < 0.01
    assert result.converged.all()
    # Nobody moves as this made-up motion does: without the prior of how people do it fits all over.
    assert motion.errors(run(motion, found, lambda_motion=0.0)).mean() < 0.005
    assert np.allclose(np.linalg.norm(np.diff(result.joints_head[:, 2:4], axis=1), axis=-1),
                       motion.person.bone_lengths["left_elbow"])  # fmt: skip


def test_smoothing_beats_single_frames(motion):
    found = motion.detect("simulated:2", hidden=0.3)
    errors = {
        kind: motion.errors(run(motion, found, smoothing=kind)).mean()
        for kind in ("none", "gaussian", "interval")
    }
    assert errors["interval"] < 0.7 * errors["none"]
    assert errors["gaussian"] < errors["none"]
    assert errors["interval"] < 0.02


def test_wild_detections_are_outvoted(motion):
    clean = motion.errors(run(motion, motion.detect("simulated:2", hidden=0.3)))
    wild = motion.errors(run(motion, motion.detect("simulated:2,outliers=0.3", hidden=0.3)))
    assert np.median(wild) < 1.5 * np.median(clean)


def test_other_image_size_gives_the_same_accuracy(motion):
    big = replace(motion, rig=motion.rig.resized(1280, 1024))
    small_error = motion.errors(run(motion, motion.detect("simulated:2"))).mean()
    big_error = motion.errors(run(big, big.detect("simulated:2"))).mean()
    assert big_error == pytest.approx(small_error, rel=0.1)


def test_nothing_detected_is_the_rest_pose_without_nan(motion):
    found = motion.detect("simulated:2", hidden=1.0)
    assert not found.valid.any()
    result = run(motion, found)
    for array in (result.angles, result.joints_head, result.energy):
        assert np.isfinite(array).all()
    assert (result.detections_used == 0).all()


@pytest.mark.parametrize("kind", ["none", "gaussian", "interval"])
def test_garbage_never_gives_nan(motion, kind):
    found = motion.detect("simulated:0,outliers=1", hidden=1.0)
    assert found.valid.all()
    result = run(motion, found, smoothing=kind)
    assert np.isfinite(result.joints_head).all() and np.isfinite(result.energy).all()


def test_nan_and_infinity_marked_valid_are_missing(motion):
    found = motion.detect("simulated:1")
    points = found.points.copy()
    points[10, 0], points[11, 1] = np.nan, np.inf
    sigma, confidence = found.sigma.copy(), found.confidence.copy()
    sigma[10, 1, :9], confidence[11, 0, :9] = np.nan, np.inf
    result = run(
        motion,
        replace(found, points=points, sigma=sigma, confidence=confidence,
                valid=np.ones_like(found.valid)),
    )  # fmt: skip
    assert np.isfinite(result.joints_head).all()
    assert motion.errors(result)[10:12].mean() < 0.02


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_very_short_sequences(motion, frames):
    found = motion.detect("simulated:1")
    few = {
        n: getattr(found, n)[:frames] for n in ("times", "points", "sigma", "confidence", "valid")
    }
    result = run(motion, replace(found, **few))
    assert result.joints_head.shape == (frames, 18, 3)
    assert np.linalg.norm(result.joints_head - motion.joints[:frames], axis=-1).mean() < 0.04


def test_dropped_frames(motion):
    keep = np.r_[0:30, 36:60, 61:90]
    found = motion.detect("simulated:1")
    some = {n: getattr(found, n)[keep] for n in ("times", "points", "sigma", "confidence", "valid")}
    result = run(motion, replace(found, **some))
    errors = np.linalg.norm(result.joints_head - motion.joints[keep], axis=-1)
    assert errors[:, 1:].mean() < 0.015


def test_same_input_same_bytes(motion):
    found = motion.detect("simulated:2", hidden=0.2)
    assert np.array_equal(run(motion, found).angles, run(motion, found).angles)


def test_record_is_complete_and_survives_the_disk(motion, tmp_path):
    found = motion.detect("simulated:2", hidden=0.4)
    result = run(motion, found, zeta=0.1)
    assert result.config["tracker"]["zeta"] == 0.1
    assert result.config["detections"] == "simulated:2.0"
    assert np.array_equal(result.detections_used, found.valid.sum(axis=(1, 2)))
    assert result.seconds_per_frame > 0
    save_track(tmp_path / "t.npz", result)
    assert np.array_equal(load_track(tmp_path / "t.npz").angles, result.angles)


def test_bad_input_is_named(motion):
    found = motion.detect("simulated:1")
    with pytest.raises(InputError, match="times"):
        run(motion, replace(found, times=found.times[::-1].copy()))
    empty = Detections(
        np.zeros(0), np.zeros((0, 2, 18, 2)), np.zeros((0, 2, 18)), np.zeros((0, 2, 18)),
        np.zeros((0, 2, 18), bool), "test",
    )  # fmt: skip
    with pytest.raises(InputError, match="no frames"):
        run(motion, empty)
    one_eyed = replace(motion.rig, mounts=motion.rig.mounts[:1])
    with pytest.raises(InputError, match="views"):
        Tracker(one_eyed, Proportions.from_lengths(1.75)).track(found)


@pytest.mark.parametrize(
    "settings",
    [{"smoothing": "kalman"}, {"zeta": -1.0}, {"robust_scale": 0.0}, {"acceleration_sigma": np.nan},
     {"lambda_detection": np.inf}, {"max_iterations": 0}],
)  # fmt: skip
def test_bad_settings_are_named(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        TrackerConfig(**settings)


def blanked(motion, frames, source="simulated:2", views=slice(None)):
    """Detections of which some frames show nothing in some views."""
    found = motion.detect(source, hidden=0.2)
    valid = found.valid.copy()
    valid[frames, views] = False
    return replace(found, valid=valid)


@pytest.mark.parametrize("kind", ["none", "interval"])
@pytest.mark.parametrize("source", ["simulated:2", LEARNED_LIKE])
def test_back_within_three_frames_of_a_second_of_blindness(motion, kind, source):
    result = run(motion, blanked(motion, slice(30, 60), source), smoothing=kind)
    usual = np.median(motion.errors(run(motion, motion.detect(source), smoothing=kind)))
    assert np.isfinite(result.joints_head).all()
    assert np.median(motion.errors(result)[63:66]) < 2.0 * usual + 0.005
    assert result.confidence[45, 1:].mean() < result.confidence[70, 1:].mean()


@pytest.mark.parametrize("kind", ["none", "interval"])
def test_back_within_three_frames_of_a_jump(motion, kind):
    """The person is all at once in another pose, as after a cut."""
    found, other = motion.detect("simulated:2"), make_motion(seed=5, extent=0.8)
    then = other.detect("simulated:2")
    points = np.concatenate([found.points[:45], then.points[45:]])
    valid = np.concatenate([found.valid[:45], then.valid[45:]])
    result = run(motion, replace(found, points=points, valid=valid), smoothing=kind)
    error = np.linalg.norm(result.joints_head - other.joints, axis=-1)[:, 1:]
    assert np.median(error[48:51]) < 0.03
    assert np.median(error[55:]) < 0.02


def test_one_black_camera(motion):
    result = run(motion, blanked(motion, slice(None), views=1))
    both = run(motion, blanked(motion, slice(0, 0)))
    assert np.median(motion.errors(result)) < 0.05
    assert result.confidence[:, 1:].mean() < both.confidence[:, 1:].mean()


def test_config_holds_seconds_by_stage(motion):
    result = run(motion, motion.detect("simulated:2"))
    seconds = result.config["seconds"]
    assert set(seconds) == {"observe", "frames", "smoothing", "covariance", "joints"}
    assert sum(seconds.values()) == pytest.approx(result.seconds_per_frame * len(result.times))
    assert result.energies.shape == (90, 4)
    assert np.allclose(result.energies[:, :2].sum(1), result.energy)
    assert (result.energies[2:, 2] > 0).all() and (result.energies[:, 3] == 0).all()
    assert np.array_equal(result.offsets, motion.person.offsets)
