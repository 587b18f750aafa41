"""Rays of two views tell whether the views fit the rig, the other order, or neither."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.geometry import axis_angle
from egocap.track.view_agreement import check_agreement
from tests.egocap.conftest import RIG, make_motion


@pytest.fixture(scope="module")
def made():
    return make_motion(frames=60)


def test_exact_detections_of_the_right_rig_agree(made):
    found = made.detect("simulated:0.5")
    seen = check_agreement(found, made.rig)
    assert seen.pairs > 500 and seen.as_given < 0.2 and seen.exchanged > 3.0
    assert not seen.looks_exchanged and not seen.looks_like_another_rig


def test_exchanged_views_are_told(made):
    found = made.detect("simulated:1.0")
    other = replace(found, points=found.points[:, ::-1], valid=found.valid[:, ::-1],
                    confidence=found.confidence[:, ::-1], sigma=found.sigma[:, ::-1])  # fmt: skip
    seen = check_agreement(other, made.rig)
    assert seen.looks_exchanged and seen.exchanged < 0.5


def test_another_rig_is_told(made):
    right = made.rig.mounts[1]
    T = right.T_head_camera.copy()
    T[:3, :3] = axis_angle(np.array([0.0, 1.0, 0.0]), np.deg2rad(8)) @ T[:3, :3]
    other = replace(made.rig, mounts=(made.rig.mounts[0], replace(right, T_head_camera=T)))
    seen = check_agreement(made.detect("simulated:1.0"), other)
    assert seen.looks_like_another_rig and not seen.looks_exchanged


def test_a_turn_is_estimated_where_the_rays_miss_by_more_than_the_stated_errors(made):
    right = made.rig.mounts[1]
    T = right.T_head_camera.copy()
    T[:3, :3] = axis_angle(np.array([0.0, 0.0, 1.0]), np.deg2rad(5)) @ T[:3, :3]
    other = replace(made.rig, mounts=(made.rig.mounts[0], replace(right, T_head_camera=T)))
    found = made.detect("simulated:1.0")
    assert 3.0 < check_agreement(found, other).turned < 7.0
    unsure = replace(found, sigma=np.full_like(found.sigma, 12.0))
    seen = check_agreement(unsure, other)
    assert seen.as_given < seen.expected and np.isnan(seen.turned)


def test_nothing_is_said_of_too_little(made):
    found = made.detect("simulated:1.0")
    found.valid[:, 1] = False
    assert np.isnan(check_agreement(found, made.rig).as_given)


def test_exact_detections_that_state_no_error_agree(made):
    seen = check_agreement(made.detect("simulated:0"), made.rig)
    assert seen.as_given < 1e-3 and seen.expected == 0.0 and np.isnan(seen.turned)
    assert not seen.looks_exchanged and not seen.looks_like_another_rig


def test_a_detector_that_is_off_by_joint_turns_no_view():
    """Few joints common to two views fit a turn of them by chance."""
    made = replace(make_motion(frames=40, seed=5), rig=load_rig(RIG.with_name("headset4.toml")))
    found = made.detect("simulated:2.0", seed=5)
    off = np.random.default_rng(5).normal(0.0, 2.5, (1, *found.points.shape[1:]))
    assert np.isnan(check_agreement(replace(found, points=found.points + off), made.rig).turned)
