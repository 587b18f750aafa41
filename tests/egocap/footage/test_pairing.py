"""Repeated pictures by their changes: copies of moving and calm scenes, and distinct ones."""

import numpy as np
import pytest

from egocap.data.footage import ViewTiming
from egocap.footage.config import Range
from egocap.footage.pairing import ViewFrames, pair, view_frames
from egocap.footage.scan import ViewScan

N, NOISE = 600, 0.9  # pictures; change by noise alone, grey levels


def scan(change):
    blank = np.zeros((N, 3))
    return ViewScan(np.arange(N) / 30.0, np.ones(N, bool), change, np.full(N, 90.0), blank, blank)


@pytest.fixture
def changes():
    """Motion of both views with calm stretches, above the noise."""
    rng = np.random.default_rng(5)
    motion = 4.0 * np.clip(np.sin(np.arange(N) / 25.0), 0.0, None)
    return [NOISE * rng.uniform(0.9, 1.3, N) + motion * rng.uniform(0.7, 1.3, N) for _ in range(2)]


def repeated(changes):
    found = view_frames([scan(c) for c in changes], [ViewTiming()] * 2)
    return [np.flatnonzero(view.repeated).tolist() for view in found]


def test_distinct_pictures_are_not_repeated(changes):
    assert repeated(changes) == [[], []]


def test_copies_are_found_in_motion_and_in_a_calm_scene(changes):
    changes[0][[40, 120, 121]] = 0.05, 0.45, 0.04  # compressed again: hardly, coarsely, hardly
    changes[1][130] = 0.4
    assert repeated(changes) == [[40, 120, 121], [130]]


def test_a_coarsely_compressed_copy_is_found_below_the_noise_alone(changes):
    for v, change in enumerate(changes):
        change *= 1.6
        change[120] = 0.64
        change[300 + v] *= 0.62  # a distinct picture in a dip
    assert repeated(changes) == [[120], [120]]


def test_still_and_noiseless_scenes_are_not_repeated(changes):
    for change in changes:
        change[200:320] *= 0.02 / change[200:320].mean()
    assert repeated(changes) == [[], []]


@pytest.mark.parametrize("wanted, expected", [
    (Range(end=0.7), [0.5, 0.6, 0.7000000000000001]),
    (Range(start=3.7), [3.6999999999999997, 3.8]),
])  # fmt: skip
def test_start_and_end_keep_their_own_frame(wanted, expected):
    times = np.array([0.5, 0.6, 0.7000000000000001, 0.8, 3.6, 3.6999999999999997, 3.8])
    none = np.zeros(len(times), bool)
    view = ViewFrames(times, ~none, none, none, 0.1)
    found = pair([view, view], wanted, ["left", "right"]).time
    assert found[[0, -1]].tolist() == [expected[0], expected[-1]]
    assert set(expected) <= set(found.tolist())
