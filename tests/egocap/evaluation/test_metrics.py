import warnings

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


@settings(deadline=None, max_examples=12)
@given(seeds)
def test_auc_is_the_area_under_the_sampled_curve(seed):
    rng = np.random.default_rng(seed)
    errors = rng.gamma(2, 6, (4, 2, 18))
    detected, counted = rng.random((2, *errors.shape)) < 0.8
    counted[0, 0, 0] = True
    thresholds = np.linspace(0, 20, 1001)
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


def test_percentiles_are_linear_between_ranks():
    errors = np.arange(11.0).reshape(11, 1)
    assert metrics.percentile(errors, 95) == pytest.approx(9.5)
    assert metrics.percentile(errors, 30, errors >= 5) == pytest.approx(6.5)  # of 5 to 10


def test_velocity_error_is_that_of_a_drift_at_any_frame_times():
    rng = np.random.default_rng(9)
    times = np.cumsum(rng.uniform(0.01, 0.1, 30))
    truth = rng.normal(size=(30, 4, 3))
    drifting = truth + 2.0 + times[:, None, None] * [3.0, 0.0, -4.0]
    assert metrics.velocity_error(drifting, truth, times) == pytest.approx(5.0)
    assert np.isnan(metrics.velocity_error(truth[:1], truth[:1], times[:1]))


def test_velocity_error_in_single_precision_loses_no_millimetres():
    """A kilometre from the origin, float32 holds 0.06 mm: differences are taken in float64."""
    times = np.arange(3) / 30
    truth = np.full((3, 1, 3), 1000.0)
    predicted = truth.astype(np.float32)
    assert metrics.velocity_error(predicted, truth + times[:, None, None], times) == pytest.approx(
        np.sqrt(3), rel=1e-9
    )


def test_derivatives_of_missing_joints_are_not_read():
    """A joint that misses frames has a velocity between two frames that are there, and an
    acceleration over three."""
    times = np.arange(7) / 10
    truth = np.zeros((7, 2, 3))
    moving = truth.copy()
    moving[:, 0, 0] = 4.0 * times**2 / 2  # 4 m/s^2
    moving[:, 1, 1] = 10.0 * times**2 / 2
    mask = np.ones((7, 2), bool)
    mask[[0, 3], 1] = False
    moving[~mask] = np.nan
    acceleration = metrics.acceleration_error(moving, truth, times, mask)
    assert acceleration == pytest.approx((5 * 4 + 1 * 10) / 6)  # joint 1: frames 4 to 6
    speeds = [4 * (t + 0.05) for t in times[:-1]] + [10 * (t + 0.05) for t in times[[1, 4, 5]]]
    assert metrics.velocity_error(moving, truth, times, mask) == pytest.approx(np.mean(speeds))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_an_acceleration_needs_its_three_frames(missing):
    still = np.zeros((3, 1, 3))
    mask = np.arange(3)[:, None] != missing
    assert np.isnan(metrics.acceleration_error(still, still, np.arange(3.0), mask))


@pytest.mark.parametrize("missing", [0, 1])
def test_a_velocity_needs_its_two_frames(missing):
    still = np.zeros((2, 1, 3))
    mask = np.arange(2)[:, None] != missing
    assert np.isnan(metrics.velocity_error(still, still, np.arange(2.0), mask))


def test_bones_count_where_both_ends_are():
    points = np.zeros((4, 3, 3))
    points[:, 1, 0], points[:, 2, 0] = [1.0, 2.0, 1.0, 2.0], 5.0  # bones of 1 or 2, and 4 or 3
    bones, mask = ((0, 1), (1, 2)), np.ones((4, 3), bool)
    mask[1:3, 0] = mask[3, 1] = False
    truth = np.zeros((4, 3, 3))
    # left: bone 0 in frame 0, bone 1 in frames 0, 1 and 2
    assert metrics.bone_length_error(points, truth, bones, mask) == pytest.approx(12 / 4)
    drift = metrics.bone_length_drift(points, bones, mask)
    np.testing.assert_allclose(drift, [0.0, np.std([4.0, 3.0, 4.0])])
    mask[:, 0] = False
    np.testing.assert_array_equal(
        np.isnan(metrics.bone_length_drift(points, bones, mask)), [True, False]
    )


MEASURES = {
    "joint_errors": lambda p, t: metrics.joint_errors(p, t),
    "acceleration_error": lambda p, t: metrics.acceleration_error(p, t, np.arange(len(p)) / 30),
    "velocity_error": lambda p, t: metrics.velocity_error(p, t, np.arange(len(p)) / 30),
}


@pytest.mark.parametrize("measure", MEASURES.values(), ids=MEASURES)
def test_every_measure_refuses_other_axes_and_says_which(measure):
    pose = np.zeros((4, 17, 3))
    with pytest.raises(InputError) as error:
        measure(pose[..., :2], pose)
    assert str(error.value) == "predicted points have shape (4, 17, 2) (valid: (T, J, 3))"
    with pytest.raises(InputError) as error:
        measure(pose, pose[0])
    assert str(error.value) == "true points have shape (17, 3) (valid: (T, J, 3))"
    with pytest.raises(InputError) as error:
        measure(pose, pose[:, 1:])
    assert str(error.value) == (
        "predicted points have shape (4, 17, 3), the truth (4, 16, 3) (valid: the same (T, J, 3))"
    )


def test_pixel_errors_refuse_other_axes_and_numbers_of_views():
    points = np.zeros((4, 2, 18, 2))
    with pytest.raises(InputError) as error:
        metrics.pixel_errors(points[0], points[0], np.array([640, 640]))
    assert str(error.value) == "predicted points have shape (2, 18, 2) (valid: (T, V, J, 2))"
    with pytest.raises(InputError) as error:
        metrics.pixel_errors(points, points, np.full(3, 640))
    assert str(error.value) == "2 views but image widths of shape (3,)"


def test_times_that_do_not_fit_are_refused_by_frame():
    with pytest.raises(InputError) as error:
        metrics.acceleration(np.zeros((4, 1, 3)), np.array([0.0, 0.1, 0.2, 0.15]))
    assert str(error.value) == "times do not increase at frame 3 (0.15 s)"
    with pytest.raises(InputError) as error:
        metrics.acceleration(np.zeros((4, 1, 3)), np.arange(3.0))
    assert str(error.value) == "4 frames but times of shape (3,)"


def test_interval_of_two_values_by_hand():
    """Two values drawn twice: means 0, 1 and 2 with chances of a quarter, a half, a quarter."""
    rng = np.random.default_rng(10)
    values = np.array([0.0, 2.0])
    assert metrics.bootstrap_interval(values, rng) == (0.0, 2.0)
    assert metrics.bootstrap_interval(values, rng, level=0.4) == (1.0, 1.0)


def test_circular_blocks_draw_every_value_equally_often():
    """Blocks from the last values go on with the first: the draws' mean is the values' own."""
    values = np.r_[np.zeros(9), 10.0]
    low, high = metrics.bootstrap_interval(
        values, np.random.default_rng(11), block=5, level=1e-9, draws=20_001
    )
    assert low == pytest.approx(high) == pytest.approx(1.0)  # half a block in two holds the 10
    drawn = [
        metrics.bootstrap_interval(values, np.random.default_rng(k), block=4, draws=1)[0]
        for k in range(2000)
    ]
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.07)
    # three blocks of four make up ten values: each holds the 10 with a chance of 4 in 10
    assert np.var(drawn) == pytest.approx((10 / 4) ** 2 * 0.4 * 0.6 / 3, rel=0.1)


def test_level_and_draws_are_those_asked_for():
    values = np.random.default_rng(12).normal(size=200)

    def width(**options):
        low, high = metrics.bootstrap_interval(values, np.random.default_rng(1), **options)
        return high - low

    assert width() == width(level=0.95, draws=2000, block=1)
    assert width(level=0.5) / width() == pytest.approx(0.674 / 1.96, rel=0.1)


@pytest.mark.parametrize(("count", "block"), [(0, 1), (1, 1), (9, 5), (10, 0)])
def test_too_few_blocks_are_refused(count, block):
    with pytest.raises(InputError) as error:
        metrics.bootstrap_interval(np.zeros(count), np.random.default_rng(0), block=block)
    assert str(error.value) == (
        f"cannot bootstrap {count} values in blocks of {block} (valid: two blocks or more)"
    )


def test_paired_interval_is_that_of_the_differences():
    """What both have in common cancels, and the second minus the first is positive when it errs
    more."""
    rng = np.random.default_rng(13)
    common = rng.normal(scale=100.0, size=300)
    change = rng.normal(3.0, 1.0, 300)
    low, high = metrics.paired_interval(common, common + change, rng)
    half = 1.96 * change.std() / np.sqrt(300)
    assert (low, high) == pytest.approx((change.mean() - half, change.mean() + half), abs=0.02)
    options = {"block": 7, "level": 0.8, "draws": 500}
    got = metrics.paired_interval(common, common + change, np.random.default_rng(2), **options)
    alone = metrics.bootstrap_interval(change, np.random.default_rng(2), **options)
    assert got == pytest.approx(alone)
    default = metrics.paired_interval(common, common + change, np.random.default_rng(2))
    alone = metrics.bootstrap_interval(change, np.random.default_rng(2))
    assert default == pytest.approx(alone)


def test_pairs_must_be_of_the_same_frames():
    with pytest.raises(InputError) as error:
        metrics.paired_interval(np.zeros(5), np.zeros(6), np.random.default_rng(0))
    assert str(error.value) == "5 and 6 frames cannot be paired"


def test_single_precision_is_scored_in_double():
    """The same as of the same numbers in float64."""
    rng = np.random.default_rng(14)
    points, truth = rng.normal(size=(2, 40, 3, 3)).astype(np.float32)
    times = np.cumsum([1e-2, 1.0, *rng.uniform(0.01, 0.05, 38)]).astype(np.float32)
    apart = np.array([0.1, 0.6], np.float32)  # by 22 nanoseconds more than half a second
    dip = np.array([[[0.0, 0.0, -1.0], [0.0] * 3], [[0.0] * 3, [0.0] * 3]], np.float32)
    image, width = points[:, None, :, :2], np.array([1111.1], np.float32)
    errors = points[..., 0]

    def scored(real):
        return [
            metrics.joint_errors(real(points), real(truth)),
            metrics.acceleration(real(points), real(times)),
            metrics.bone_lengths(real(points), ((0, 1), (1, 2))),
            *metrics.foot_speed(real(points), real(times)),
            metrics.pixel_errors(real(image), real(image[::-1]), real(width)),
            metrics.velocity_error(real(points), real(truth), real(times)),
            metrics.estimate_planted(real(dip), real(apart)).astype(float),
            metrics.mean_error(real(errors)),
            metrics.bootstrap_interval(real(errors[:, 0]), np.random.default_rng(0)),
            metrics.paired_interval(
                real(errors[:, 0]), real(errors[:, 1]), np.random.default_rng(0)
            ),
        ]

    for single, double in zip(scored(np.float32), scored(np.float64), strict=True):
        np.testing.assert_allclose(single, double, rtol=1e-12)


def test_nothing_to_score_is_no_warning():
    nothing = np.zeros((4, 2), bool)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(metrics.mean_error(np.ones((4, 2)), nothing))
        assert np.isnan(metrics.mean_error_per_joint(np.ones((4, 2)), nothing)).all()
        assert np.isnan(metrics.percentile(np.ones((4, 2)), 50, nothing))
        assert np.isnan(metrics.foot_skate(np.zeros((4, 2, 3)), nothing, np.arange(4.0)))
