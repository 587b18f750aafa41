"""Interpolation against numpy's, of one column; nearest places against all distances."""

import numpy as np
import pytest

from egocap.series import interpolate, nearest


@pytest.mark.parametrize("count", [1, 2, 30])
def test_interpolation_is_numpys_to_the_bit(count):
    rng = np.random.default_rng(count)
    times, values = np.cumsum(rng.uniform(0.01, 1.0, count)), rng.normal(size=(count, 2, 3))
    at = np.concatenate([rng.uniform(times[0] - 1.0, times[-1] + 1.0, 40), times])
    if count > 2:
        values[count // 2] = np.nan  # reaches no farther than its neighbours
    columns = [np.interp(at, times, column) for column in values.reshape(count, -1).T]
    expected = np.stack(columns, -1).reshape(len(at), 2, 3)
    np.testing.assert_array_equal(interpolate(at, times, values), expected)
    np.testing.assert_array_equal(interpolate(float(at[0]), times, values), expected[0])


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_nearest_is_that_of_all_distances(count):
    rng = np.random.default_rng(count)
    times = np.cumsum(rng.integers(1, 4, count) / 2.0)
    wanted = rng.integers(-4, 40, 50) / 2.0  # many between two of them
    np.testing.assert_array_equal(nearest(times, wanted), np.abs(wanted[:, None] - times).argmin(1))
