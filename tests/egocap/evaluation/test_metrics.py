import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from egocap.errors import InputError
from egocap.evaluation import metrics

seeds = st.integers(0, 2**32 - 1)


def test_errors_are_distances_and_their_means():
    truth = np.zeros((2, 3, 3))
    predicted = truth.copy()
    predicted[0, 0] = [3, 4, 0]
    predicted[1, 2] = [0, 0, 2]
    errors = metrics.joint_errors(predicted, truth)
    np.testing.assert_array_equal(errors, [[5, 0, 0], [0, 0, 2]])
    assert metrics.mean_error(errors) == pytest.approx(7 / 6)
    np.testing.assert_allclose(metrics.mean_error_per_joint(errors), [2.5, 0, 1])


def test_masks_leave_entries_out_unread():
    errors = np.array([[1.0, np.nan, 3.0], [5.0, np.nan, np.inf]])
    mask = np.array([[True, False, True], [True, False, False]])
    assert metrics.mean_error(errors, mask) == 3.0
    np.testing.assert_array_equal(metrics.mean_error_per_joint(errors, mask), [3.0, np.nan, 3.0])
    assert metrics.percentile(errors, 50, mask) == 3.0
    assert np.isnan(metrics.mean_error(errors, np.zeros_like(mask)))
    assert np.isnan(metrics.percentile(errors, 95, np.zeros_like(mask)))


@pytest.mark.parametrize("joints", [2, 3, 17])
def test_score_does_not_depend_on_the_number_of_frames_scored_together(joints):
    rng = np.random.default_rng(0)
    truth, predicted = rng.normal(size=(2, 6, joints, 3))
    whole = metrics.joint_errors(predicted, truth)
    for size in (1, 2, 3):
        rows = [
            metrics.joint_errors(predicted[i : i + size], truth[i : i + size])
            for i in range(0, 6, size)
        ]
        np.testing.assert_array_equal(np.concatenate(rows), whole)
    by_hand = [[np.sqrt(((p - t) ** 2).sum()) for p, t in zip(*frame, strict=True)]
               for frame in zip(predicted, truth, strict=True)]  # fmt: skip
    np.testing.assert_allclose(whole, by_hand)


@pytest.mark.parametrize("shape", [(4, 3, 17), (17, 3), (2, 4, 17, 3), (4, 17, 2)])
def test_another_axis_order_is_refused_not_guessed(shape):
    with pytest.raises(InputError, match=r"\(T, J, 3\)"):
        metrics.joint_errors(np.zeros(shape), np.zeros(shape))


def test_shapes_must_agree():
    with pytest.raises(InputError, match="the same"):
        metrics.joint_errors(np.zeros((4, 17, 3)), np.zeros((5, 17, 3)))


def test_acceleration_of_a_fall_at_uneven_times_is_exact():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.01, 0.1, 40))
    start, speed = rng.normal(size=(2, 5, 3))
    fall = start + speed * times[:, None, None] - 0.5 * 9.81 * times[:, None, None] ** 2
    np.testing.assert_allclose(metrics.acceleration(fall, times), -9.81, rtol=1e-6)


def test_acceleration_agrees_with_a_spline():
    times = np.linspace(0, 2, 401)
    points = np.stack([np.sin(3 * times), np.cos(2 * times), times**3], -1)[:, None]
    spline = CubicSpline(times, points)(times, 2)[1:-1]
    np.testing.assert_allclose(metrics.acceleration(points, times), spline, atol=2e-2)


def test_acceleration_error_of_white_noise():
    # each axis of the second difference of white noise has variance (1 + 4 + 1) s^2 / dt^4
    rng = np.random.default_rng(2)
    dt, sigma = 1 / 30, 0.01
    truth = np.zeros((4000, 2, 3))
    noise = rng.normal(scale=sigma, size=truth.shape)
    mean_of_maxwell = 2 * np.sqrt(2 / np.pi)
    expected = mean_of_maxwell * np.sqrt(6) * sigma / dt**2
    error = metrics.acceleration_error(noise, truth, np.arange(4000) * dt)
    assert error == pytest.approx(expected, rel=0.03)


def test_acceleration_error_ignores_an_offset_and_a_drift():
    rng = np.random.default_rng(3)
    truth, times = rng.normal(size=(20, 17, 3)), np.arange(20) / 30
    drifting = truth + 0.1 + 0.5 * times[:, None, None]
    assert metrics.acceleration_error(drifting, truth, times) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("frames", [1, 2])
def test_acceleration_error_needs_three_frames(frames):
    pose = np.zeros((frames, 17, 3))
    assert np.isnan(metrics.acceleration_error(pose, pose, np.arange(frames) / 30.0))


def test_times_must_increase():
    with pytest.raises(InputError, match="frame 2"):
        metrics.acceleration(np.zeros((4, 1, 3)), np.array([0.0, 0.1, 0.1, 0.2]))


def test_bones():
    rng = np.random.default_rng(4)
    direction = rng.normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    length = 0.3 + 0.02 * (np.arange(50) % 2)  # standard deviation 0.01
    points = rng.normal(size=(50, 3, 3))
    points[:, 1] = points[:, 0] + length[:, None] * direction
    points[:, 2] = points[:, 1] + 0.4 * direction
    bones = ((0, 1), (1, 2))
    np.testing.assert_allclose(metrics.bone_lengths(points, bones)[:, 1], 0.4)
    np.testing.assert_allclose(metrics.bone_length_drift(points, bones), [0.01, 0], atol=1e-12)
    assert metrics.bone_length_error(2 * points, points, bones) == pytest.approx(0.355)


def seen_everywhere(shape):
    return np.ones(shape, bool), np.ones(shape, bool)


def test_pixel_errors_are_at_640_whatever_the_image_size():
    rng = np.random.default_rng(5)
    truth = rng.uniform(0, 500, (3, 2, 18, 2))
    predicted = truth + [3.0, 4.0]
    errors = metrics.pixel_errors(predicted, truth, np.array([1280, 640]))
    np.testing.assert_allclose(errors[:, 0], 2.5)
    np.testing.assert_allclose(errors[:, 1], 5.0)
    with pytest.raises(InputError, match="2 views"):
        metrics.pixel_errors(predicted, truth, np.array([1280]))


def test_a_perfect_prediction_scores_exactly_100():
    errors = np.zeros((5, 2, 18))
    masks = seen_everywhere(errors.shape)
    for threshold in (0, 1, 20):
        assert metrics.pck(errors, *masks, threshold) == 100
    assert metrics.auc(errors, *masks, 20) == 100


def test_thresholds_include_their_bound():
    errors = np.array([20.0, np.nextafter(20.0, 21.0)])
    assert metrics.pck(errors, *seen_everywhere(2), 20) == 50


def test_missing_detections_are_misses_and_uncounted_joints_nothing():
    errors = np.array([0.0, np.nan, 0.0, 99.0])
    detected = np.array([True, False, True, True])
    counted = np.array([True, True, True, False])
    assert metrics.pck(errors, detected, counted, 20) == pytest.approx(200 / 3)
    assert metrics.auc(errors, detected, counted, 20) == pytest.approx(200 / 3)
    assert np.isnan(metrics.pck(errors, detected, np.zeros(4, bool), 20))
    assert np.isnan(metrics.auc(errors, detected, np.zeros(4, bool), 20))


@settings(deadline=None, max_examples=30)
@given(seeds)
def test_auc_is_the_area_under_the_sampled_curve(seed):
    rng = np.random.default_rng(seed)
    errors = rng.gamma(2, 6, (4, 2, 18))
    detected, counted = rng.random((2, *errors.shape)) < 0.8
    counted[0, 0, 0] = True
    thresholds = np.linspace(0, 20, 4001)
    curve = [metrics.pck(errors, detected, counted, t) for t in thresholds]
    area = np.trapezoid(curve, thresholds) / 20
    assert metrics.auc(errors, detected, counted, 20) == pytest.approx(area, abs=0.05)
    assert np.all(np.diff(curve) >= 0)


def test_interval_of_independent_values_is_the_normal_one():
    rng = np.random.default_rng(6)
    values = rng.normal(10, 2, 400)
    low, high = metrics.bootstrap_interval(values, rng)
    half = 1.96 * values.std() / np.sqrt(400)
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.03)


def test_blocks_see_that_neighbours_err_alike():
    rng = np.random.default_rng(7)
    covered = {1: 0, 30: 0}
    for _ in range(60):
        noise = rng.normal(size=900 + 19)
        values = np.convolve(noise, np.ones(20), "valid")  # mean 0, alike over 20 frames
        for block in covered:
            low, high = metrics.bootstrap_interval(values, rng, block=block, draws=300)
            covered[block] += low <= 0 <= high
    assert covered[30] >= 48  # nominal 57
    assert covered[1] <= 36


def test_interval_repeats_with_its_generator_and_refuses_too_little():
    values = np.random.default_rng(8).normal(size=50)
    first, second = (
        metrics.bootstrap_interval(values, np.random.default_rng(1), block=7) for _ in range(2)
    )
    assert first == second
    with pytest.raises(InputError, match="two blocks"):
        metrics.bootstrap_interval(values, np.random.default_rng(1), block=26)
