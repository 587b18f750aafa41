import numpy as np
import pytest

from egocap.evaluation.metrics import (
    PLANTED_HEIGHT,
    PLANTED_SPEED,
    WINDOW_S,
    estimate_planted,
    f1_score,
    foot_skate,
    foot_speed,
)
from tests.egocap.conftest import peak_below


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


def test_speeds_of_a_parabola_at_uneven_times_are_exact():
    """Central differences that take the spacing into account know parabolas inside."""
    times = np.array([0.0, 0.1, 0.15, 0.35, 0.5])
    feet = np.zeros((5, 1, 3))
    feet[:, 0] = times[:, None] * [3.0, 4.0, 0.0] + times[:, None] ** 2 * [0.0, 0.0, 6.0]
    horizontal, whole = foot_speed(feet, times)
    np.testing.assert_allclose(horizontal[:, 0], 5.0)
    np.testing.assert_allclose(whole[1:-1, 0], np.hypot(5.0, 12.0 * times[1:-1]))


def test_landing_and_lifting_are_no_skating():
    """Planted in frames 2 to 5: their first and last are left out, at either end of the motion
    as well as inside."""
    times = np.arange(8) / 10
    feet = np.zeros((8, 1, 3))
    feet[:, 0, 0] = np.cumsum([0, 9, 9, 9, 0.1, 0.1, 9, 9])  # slow from frame 3 to 5 only
    planted = np.zeros((8, 1), bool)
    planted[2:6] = True
    # frame 3: (9 + 0.1) / 0.2 s, frame 4: 0.2 / 0.2 s
    assert foot_skate(feet, planted, times) == pytest.approx((45.5 + 1.0) / 2)
    planted[3] = False  # and with it its neighbours
    assert np.isnan(foot_skate(feet, planted, times))
    planted[:] = True
    speeds = np.gradient(feet[:, 0, 0], times)
    assert foot_skate(feet, planted, times) == pytest.approx(speeds.mean())


def test_skating_needs_three_frames():
    feet = np.zeros((3, 1, 3))
    assert foot_skate(feet, np.ones((3, 1), bool), np.arange(3.0)) == 0.0
    assert np.isnan(foot_skate(feet[:2], np.ones((2, 1), bool), np.arange(2.0)))


def test_foot_stands_up_to_its_speed_and_height():
    times = np.arange(5) / 4  # each frame sees those half a second before and behind

    def standing(speed=0.0, height=0.0):
        feet = np.zeros((5, 2, 3))
        feet[:, 1, 1], feet[:, 1, 2] = speed * times, height
        return estimate_planted(feet, times)[2]

    second = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [1.2, 0.0, 0.0]])[:, None]
    assert estimate_planted(second, np.arange(3.0)).all()
    np.testing.assert_array_equal(standing(speed=0.601), [True, False])
    np.testing.assert_array_equal(standing(height=0.03), [True, True])
    np.testing.assert_array_equal(standing(height=0.031), [True, False])


@pytest.mark.parametrize(("away", "stands"), [(2, False), (3, True)])
def test_floor_is_the_lowest_toe_within_half_a_second(away, stands):
    """A dip to 1 m below counts at 0.5 s, before or behind, and not at 0.75 s."""
    times, feet = np.arange(13) / 4, np.zeros((13, 2, 3))
    feet[6, 0, 2] = -1.0
    for frame in (6 - away, 6 + away):
        assert estimate_planted(feet, times)[frame, 1] == stands


def test_planted_feet_are_those_of_all_pairs_of_frames():
    rng = np.random.default_rng(8)
    for times in (np.arange(150) / 60, np.cumsum(rng.uniform(0.001, 0.2, 150))):
        feet = np.cumsum(rng.normal(0, 0.004, (150, 2, 3)), 0)
        near = np.abs(times[:, None] - times) <= WINDOW_S
        floor = np.where(near, feet[..., 2].min(-1), np.inf).min(-1)
        low = feet[..., 2] - floor[:, None] <= PLANTED_HEIGHT
        expected = low & (foot_speed(feet, times)[1] <= PLANTED_SPEED)
        assert 0 < expected.sum() < expected.size
        np.testing.assert_array_equal(estimate_planted(feet, times), expected)


def test_memory_of_planted_feet_is_linear_in_the_frames():
    feet, times = np.zeros((20_000, 2, 3)), np.arange(20_000) / 60
    with peak_below(10e6):
        estimate_planted(feet, times)
