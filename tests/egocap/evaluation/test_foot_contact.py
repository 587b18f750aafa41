import numpy as np
import pytest

from egocap.evaluation.metrics import estimate_planted, f1_score, foot_skate


def steps(frames=120):
    """Two feet in turn: half a second planted, half a second swinging 0.6 m, 10 cm high."""
    times = np.arange(frames) / 30
    feet = np.zeros((frames, 2, 3))
    planted = np.zeros((frames, 2), bool)
    for f, phase in enumerate((0.0, 0.5)):
        cycle, part = np.divmod(times + phase, 1.0)
        swing = np.clip(part - 0.5, 0, None) / 0.5
        feet[:, f, 0] = 0.6 * (cycle + 0.5 * (1 - np.cos(np.pi * swing)))
        feet[:, f, 2] = 0.1 * np.sin(np.pi * swing) ** 2
        planted[:, f] = swing == 0
    return feet, planted, times


def test_planted_feet_do_not_skate_and_a_drift_is_measured():
    feet, planted, times = steps()
    assert foot_skate(feet, planted, times) == pytest.approx(0, abs=1e-9)
    drifting = feet + times[:, None, None] * [0.3, 0.4, 2.0]
    assert foot_skate(drifting, planted, times) == pytest.approx(0.5)
    assert np.isnan(foot_skate(feet, np.zeros_like(planted), times))


def test_contacts_are_found_on_a_floor_of_any_height():
    feet, planted, times = steps()
    assert f1_score(estimate_planted(feet, times), planted) > 0.9
    np.testing.assert_array_equal(
        estimate_planted(feet + 7.0, times), estimate_planted(feet, times)
    )


def test_f1_by_hand():
    truth = np.array([1, 1, 1, 0, 0, 0], bool)
    found = np.array([1, 1, 0, 1, 0, 0], bool)
    assert f1_score(found, truth) == pytest.approx(2 * (2 / 3) * (2 / 3) / (4 / 3))
    assert f1_score(truth, truth) == 1 and np.isnan(f1_score(~truth & truth, ~truth & truth))
