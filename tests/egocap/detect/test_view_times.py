"""Detections at the frames' times: exact for motion at a constant speed."""

from pathlib import Path

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.data.footage import FrameTimes
from egocap.detect.detector import no_detections
from egocap.detect.view_times import at_frame_times

T = 12
TIME = np.arange(T) / 30.0
START, SPEED = np.array([100.0, 50.0]), np.array([90.0, -60.0])  # px, px/s
RIG = load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml").resized(640, 512)


def detections(taken):
    """Every joint moves evenly; each view sees it at its own times."""
    found = no_detections(TIME, 2, "test")
    found.points[:] = (START + SPEED * taken[..., None])[:, :, None]
    found.modes[:] = found.points[..., None, :]
    found.valid[:] = True
    return found


def times(late, present=None):
    taken = np.stack([TIME, TIME + late], 1)
    here = np.ones((T, 2), bool) if present is None else present
    return FrameTimes(TIME, taken, np.zeros((T, 2), int), here)


@pytest.mark.parametrize("late", [0.012, -0.012])
def test_even_motion_is_followed_exactly(late):
    when = times(late)
    moved = at_frame_times(detections(when.taken), when, RIG)
    expected = START + SPEED * TIME[:, None]
    inner = slice(1, -1)  # an end has no neighbour beyond
    np.testing.assert_allclose(moved.points[inner, 1, 7], expected[inner], atol=1e-9)
    np.testing.assert_allclose(moved.points[:, 0, 7], expected, atol=1e-9)
    np.testing.assert_allclose(moved.modes[inner, 1, 7, 2], expected[inner], atol=1e-9)


def test_pictures_that_are_missing_are_stepped_over():
    present = np.ones((T, 2), bool)
    present[5, 1] = False
    when = times(-0.01, present)
    found = detections(when.taken)
    found.valid[5, 1] = False
    found.points[5, 1] = np.nan
    moved = at_frame_times(found, when, RIG)
    np.testing.assert_allclose(moved.points[6, 1, 0], START + SPEED * TIME[6], atol=1e-9)
    np.testing.assert_allclose(moved.points[4, 1, 0], START + SPEED * TIME[4], atol=1e-9)


def test_a_jump_is_no_motion():
    when = times(0.012)
    found = detections(when.taken)
    found.points[6, 1, 3] += 200.0
    moved = at_frame_times(found, when, RIG)
    np.testing.assert_array_equal(moved.points[6, 1, 3], found.points[6, 1, 3])
    assert np.abs(moved.points[7, 1, 3] - found.points[7, 1, 3]).max() < 2.0


def test_pictures_taken_together_stay():
    when = times(0.0002)
    found = detections(when.taken)
    assert at_frame_times(found, when, RIG) is found
