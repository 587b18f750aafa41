"""Stated errors of a floor against those of rigs with planted errors."""

import numpy as np
import pytest

from egocap.head_pose import rig_errors
from egocap.head_pose.floor import Floor, Pictured, find_floor
from egocap.head_pose.rig_errors import floor_errors
from egocap.head_pose.vertical import Vertical, find_vertical
from egocap.odometry.self_calibration import PARAMETERS, RigSearch, corrected
from egocap.odometry.views import Motion, Views
from tests.egocap.odometry.box_world import BoxWorld, small_rig, walk

VIEWS, POSES = Views.of(small_rig(640, 512), 640), walk(40)[[0, 13, 26, 39]]
UP = np.array([0.0, 0.0, 1.0])
COVARIANCE = 0.2**2 * RigSearch.fruitless(VIEWS).covariance
"""Of rotations of 0.1 degrees, and in proportion."""


@pytest.fixture(scope="module")
def frames():
    world = BoxWorld(contrast=15.0)
    return [(T, Pictured(world.pictures(VIEWS.rig, T), Motion.none(2))) for T in POSES]


def test_floors_of_wrong_rigs_err_as_is_stated(frames, monkeypatch, rng):
    monkeypatch.setattr(rig_errors, "SCALE_STD", 0.0)
    tilts, heights = [], []
    for _ in range(10):
        values = rng.multivariate_normal(np.zeros(22), COVARIANCE).reshape(2, len(PARAMETERS))
        found = find_floor(corrected(VIEWS, values), frames, UP)
        tilt = np.arccos(min(found.normal @ UP, 1.0))
        middle = POSES[:, :3, 3].mean(0) * (1, 1, 0)
        tilts.append(tilt)
        heights.append(found.height - middle @ found.normal)
    tilt, height = floor_errors(VIEWS, frames, Floor(UP, 0.0, 0.0, 0.0), COVARIANCE)
    assert np.sqrt(np.mean(np.square(tilts))) / tilt == pytest.approx(1.0, abs=0.4)
    assert np.sqrt(np.mean(np.square(heights))) / height == pytest.approx(1.0, abs=0.4)


def test_heights_err_with_the_distance_between_the_cameras(frames):
    """Which no picture tells: of an otherwise exact rig, the share of the head's height."""
    exact = np.zeros_like(COVARIANCE)
    tilt, height = floor_errors(VIEWS, frames, Floor(UP, 0.0, 0.0, 0.0), exact)
    assert tilt == 0.0
    assert height == pytest.approx(rig_errors.SCALE_STD * POSES[:, 2, 3].mean(), rel=1e-6)


def test_what_is_unknown_of_the_rig_does_not_touch_what_an_imu_feels(frames):
    points, heads = np.zeros((0, 3)), POSES
    for std in (np.deg2rad(0.5), np.deg2rad(0.01)):
        imu = Vertical(UP, std, "imu")
        found = find_vertical(VIEWS, points, heads, frames, imu, COVARIANCE)
        alone = find_vertical(VIEWS, points, heads, frames, imu)
        assert found.floor_std > alone.floor_std
        assert found.up_std == std  # a floor by this rig is less certain than either
    without = find_vertical(VIEWS, points, heads, frames, None, COVARIANCE)
    assert without.source == "the floor" and without.up_std > np.deg2rad(0.5)
