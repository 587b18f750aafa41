"""Attitudes of the trunk: their definition, learning with a known answer, and the file in use."""

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.consistency.attitude import (
    FILE,
    Attitudes,
    attitudes,
    learn_attitudes,
    load_attitudes,
    save_attitudes,
)
from egocap.errors import FileError
from egocap.geometry import axis_angle, exponential
from tests.egocap.conftest import rewritten

REST = Proportions.from_lengths(1.75).rest_joints


@pytest.mark.parametrize(("axis", "index"), [((1, 0, 0), 0), ((0, 1, 0), 1), ((0, 0, 1), 2)])
def test_attitude_is_the_rotation_of_a_body_at_rest(axis, index):
    R = axis_angle(np.array(axis, float), 0.3)
    rest = attitudes(REST)
    off = attitudes(REST @ R.T) - rest
    assert off[index] == pytest.approx(0.3, abs=0.02)
    assert np.abs(np.delete(off, index)).max() < 0.03


def test_learns_a_known_spread_between_recordings():
    rng, degrees = np.random.default_rng(0), np.array([4.0, 8.0, 10.0])
    recordings = []
    for off in rng.normal(size=(400, 3)) * np.deg2rad(degrees):
        R = exponential(off)
        recordings.append(np.tile(REST @ R.T, (3, 1, 1)))
    spread = np.rad2deg(np.sqrt(np.diag(learn_attitudes(recordings).covariance)))
    np.testing.assert_allclose(spread, degrees[[0, 2]], rtol=0.1)


def test_the_one_in_use_tells_a_roll_of_20_degrees_and_takes_usual_attitudes():
    learned = load_attitudes()
    roll, yaw = np.sqrt(np.diag(learned.covariance))
    for usual in ((roll, 0.0, 0.0), (0.0, np.deg2rad(-30.0), 0.0), (0.0, 0.0, yaw)):
        assert learned.probability(np.array(usual)) > 0.97
    for side in (-1.0, 1.0):
        rolled = np.deg2rad([side * 20.0, 0.0, 0.0])
        assert learned.probability(rolled) < 0.1
        name, off = learned.oddest(rolled)
        assert name == "roll" and off == pytest.approx(side * np.deg2rad(20.0))


def test_probability_is_bayes_rule():
    one = Attitudes(np.deg2rad(8.0) ** 2 * np.eye(2))
    density = 0.9 / (2.0 * np.pi * 8.0**2)  # a square degree
    assert one.probability(np.zeros(3)) == pytest.approx(density / (density + 0.1 / 90.0**2))


def test_round_trip(tmp_path):
    learned = load_attitudes()
    save_attitudes(learned, 7, tmp_path / "a.json")
    again = load_attitudes(tmp_path / "a.json")
    np.testing.assert_allclose(again.covariance, learned.covariance, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop("recordings"), "recordings"),
        (lambda d: d["covariance_deg2"].pop(), "covariance_deg2"),
        (lambda d: d["covariance_deg2"][0].__setitem__(0, -1.0), "positive definite"),
    ],
)
def test_bad_files_are_named(tmp_path, change, says):
    with pytest.raises(FileError, match=says):
        load_attitudes(rewritten(FILE, change, tmp_path / "a.json"))
