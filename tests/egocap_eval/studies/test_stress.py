"""Sweeps change one thing at a time, by what they say, and the errors follow."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap_eval.cli import main
from egocap_eval.harness.cases import run_sweep
from egocap_eval.harness.motion_truth import draw_detections, on_rig, simulate_motion
from egocap_eval.studies.stress import (
    MEASURES,
    SWEEPS,
    best_level,
    judge_baseline,
    score,
    turned_rig,
    with_baseline,
    with_fov,
    with_offset,
)


@pytest.fixture(scope="module")
def motion():
    return simulate_motion("walk", frames=45, seed=400911)


def test_a_performance_is_what_the_cameras_would_see(motion):
    truth = motion.truth
    pixels, in_view = motion.rig.project(truth.joints_head)
    seen = np.moveaxis(in_view, 0, 1)
    np.testing.assert_allclose(truth.joints_2d[seen], np.moveaxis(pixels, 0, 1)[seen])
    assert not motion.seen[~truth.in_view].any() and 0.4 < motion.seen.mean() < 0.95
    found = draw_detections(motion, "simulated:0", 0)
    np.testing.assert_array_equal(found.points[found.valid], truth.joints_2d[found.valid])
    again = simulate_motion("walk", frames=45, seed=400911)
    np.testing.assert_array_equal(again.truth.visibility, truth.visibility)


def test_another_baseline_and_nothing_else(motion):
    for metres in (0.05, 0.6):
        rig = with_baseline(motion.rig, metres)
        a, b = (m.T_head_camera for m in rig.mounts)
        assert np.linalg.norm(a[:3, 3] - b[:3, 3]) == pytest.approx(metres)
        for before, after in zip(motion.rig.mounts, rig.mounts, strict=True):
            np.testing.assert_array_equal(after.T_head_camera[:3, :3], before.T_head_camera[:3, :3])
    moved = on_rig(motion, with_baseline(motion.rig, 0.6))
    np.testing.assert_array_equal(moved.truth.joints_head, motion.truth.joints_head)
    assert np.abs(moved.truth.joints_2d - motion.truth.joints_2d)[motion.seen].max() > 5


def test_a_narrow_lens_sees_less_and_only_what_is_ahead(motion):
    narrow = with_fov(motion, np.deg2rad(60))
    lost = motion.truth.in_view & ~narrow.truth.in_view
    assert lost.any() and (narrow.truth.visibility[lost] == OUT_OF_VIEW).all()
    rays = motion.truth.joints_camera[narrow.truth.visibility == VISIBLE]
    angle = np.arctan2(np.linalg.norm(rays[:, :2], axis=-1), rays[:, 2])
    assert angle.max() <= np.deg2rad(60) + 1e-9


def test_cameras_are_turned_by_the_angle_asked_for(motion):
    turned = turned_rig(motion.rig, 0.02, np.random.default_rng(0))
    for before, after in zip(motion.rig.mounts, turned.mounts, strict=True):
        R = before.T_head_camera[:3, :3].T @ after.T_head_camera[:3, :3]
        assert np.arccos((np.trace(R) - 1) / 2) == pytest.approx(0.02, rel=1e-6)
        np.testing.assert_array_equal(before.T_head_camera[:3, 3], after.T_head_camera[:3, 3])


def test_a_late_camera_shows_the_next_frame_a_frame_later(motion):
    late = with_offset(motion, 1 / 30).truth.joints_2d
    both = motion.truth.in_view[1:, 1] & motion.truth.in_view[:-1, 1]
    np.testing.assert_allclose(late[:-1, 1][both], motion.truth.joints_2d[1:, 1][both], atol=1e-6)
    np.testing.assert_array_equal(late[:, 0], motion.truth.joints_2d[:, 0])


def test_errors_grow_with_the_fault(motion):
    sweep = SWEEPS["calibration"]
    ends = replace(sweep, levels={angle: sweep.levels[angle] for angle in (0.0, 4.0)})
    twice = {"first": motion, "again": motion}
    small, large = run_sweep("ends", ends, twice, score, MEASURES, seeds=2)["levels"]
    assert large["mpjpe_mm"]["mean"] > 2 * small["mpjpe_mm"]["mean"]
    # the same motion twice: seeds do not make an interval, motions do
    assert len(small["draws"]["mpjpe_mm"]) == 2
    assert small["mpjpe_mm"]["half_interval"] == pytest.approx(0)


def test_the_best_level_and_those_like_it():
    common = np.random.default_rng(0).normal(20, 5, 12)
    noise = 0.2 * np.tile([1.0, -1.0], 6)  # much less than motions differ by
    levels = [
        {"value": v, "draws": {"mpjpe_mm": list(common + shift + sign * noise)}}
        for v, shift, sign in ((0.1, 5.0, 1), (0.3, 0.0, 1), (0.4, 0.05, -1), (0.6, 3.0, 1))
    ]
    found = best_level({"levels": levels})
    assert found["best"] in (0.3, 0.4) and found["not_distinguishable"] == [0.3, 0.4]
    assert found["within_5_percent"] == [0.3, 0.4]


@pytest.mark.parametrize(
    ("shifts", "verdict", "words"),
    [
        ({0.1: 5.0, 0.35: 0.0, 0.6: 3.0}, "confirmed", "at 0.6 m"),
        ({0.1: 5.0, 0.35: 2.0, 0.6: 0.0}, "refuted", "2.0 +- 0."),
        ({0.1: 5.0, 0.35: 0.05, 0.6: 0.0}, "not settled", "less than at 0.35 m"),
    ],
)
def test_the_papers_distance_is_judged_by_pairs(shifts, verdict, words):
    common = np.random.default_rng(0).normal(20, 5, 6)  # motions differ by more than distances
    noise = 0.2 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    levels = [
        {"value": v, "draws": {"mpjpe_mm": list(common + shift + (1 + v) * noise)}}
        for v, shift in shifts.items()
    ]
    found = judge_baseline({"levels": levels})
    assert found["verdict"] == verdict and words in found["words"]
    assert found["paper_best"] == 0.35


def test_sweeps_have_levels_in_order():
    for name, sweep in SWEEPS.items():
        values = list(sweep.levels)
        assert values == sorted(values) and len(set(values)) >= 5, name


def test_no_seed_is_refused(capsys):
    assert main(["stress", "--seeds", "0"]) == 2
    assert "1 or more" in capsys.readouterr().err
