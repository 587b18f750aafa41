"""Smoothing over time: fixed points, gaps, windows, and the Gaussian low-pass."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from egocap.body.skeleton import forward
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.observations import observe
from egocap.track import smoother

CONFIG = TrackerConfig()


def setup(motion, source, config=CONFIG, **kwargs):
    seen = observe(motion.detect(source, **kwargs), motion.rig, motion.person, config)
    return seen, kernel.make_model(motion.person, config)


def error(motion, angles):
    return np.linalg.norm(forward(motion.person, angles) - motion.joints, axis=-1)[:, 1:]


def test_smoothing_the_truth_leaves_it(motion):
    seen, model = setup(motion, "simulated:0")
    smoothed, converged = smoother.smooth_interval(motion.angles, seen, model, CONFIG)
    assert converged.all()
    assert error(motion, smoothed).mean() < 0.004


def test_a_gap_is_bridged_by_the_motion_around_it(motion):
    seen, model = setup(motion, "simulated:0")
    seen.weights[40:45] = 0
    smoothed, _ = smoother.smooth_interval(motion.angles, seen, model, CONFIG)
    assert error(motion, smoothed)[40:45].mean() < 0.02
    held = np.repeat(motion.angles[39:40], 5, axis=0)
    still = np.linalg.norm(forward(motion.person, held) - motion.joints[40:45], axis=-1)[:, 1:]
    assert error(motion, smoothed)[40:45].mean() < 0.5 * still.mean()


def test_windows_join_without_a_seam(motion, monkeypatch):
    seen, model = setup(motion, "simulated:2")
    whole, _ = smoother.smooth_interval(motion.angles, seen, model, CONFIG)
    monkeypatch.setattr(smoother, "WINDOW", 30)
    monkeypatch.setattr(smoother, "MARGIN", 20)
    parts, _ = smoother.smooth_interval(motion.angles, seen, model, CONFIG)
    joints = forward(motion.person, whole), forward(motion.person, parts)
    assert np.linalg.norm(joints[0] - joints[1], axis=-1).max() < 0.003


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_very_short_motions(motion, frames):
    from dataclasses import replace

    seen, model = setup(motion, "simulated:1")
    few = replace(
        seen, times=seen.times[:frames], rays=seen.rays[:frames], whiten=seen.whiten[:frames],
        weights=seen.weights[:frames],
    )  # fmt: skip
    smoothed, _ = smoother.smooth_interval(motion.angles[:frames], few, model, CONFIG)
    assert smoothed.shape == (frames, 37) and np.isfinite(smoothed).all()


def test_gaussian_low_pass_against_scipy():
    angles = np.random.default_rng(0).normal(size=(40, 37))
    smoothed = smoother.smooth_gaussian(angles, 1.0)
    expected = gaussian_filter1d(angles, 1.0, axis=0, radius=2)
    assert np.allclose(smoothed[2:-2], expected[2:-2])
    assert np.allclose(smoother.smooth_gaussian(np.ones((7, 37)), 1.0), 1)
    assert np.array_equal(smoother.smooth_gaussian(angles, 0.0), angles)
