"""Measures of calibration against draws whose answer is known, and against counting."""

import numpy as np
import pytest

from egocap.evaluation.detection_scores import (
    LEVELS,
    auroc,
    calibration_error,
    coverage,
    median_normalised_error,
    normalised_error,
    reliability,
)

RNG = np.random.default_rng(7)
SIGMA = RNG.uniform(0.5, 9.0, 40000)
ERRORS = np.hypot(*RNG.normal(size=(2, 40000))) * SIGMA
ALL = np.ones(40000, bool)


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_honest_sigma_scores_one(factor):
    assert normalised_error(ERRORS, SIGMA / factor, ALL) == pytest.approx(factor, rel=0.01)
    assert median_normalised_error(ERRORS, SIGMA / factor, ALL) == pytest.approx(factor, rel=0.02)


def test_normalised_error_is_the_scatter_along_an_axis():
    offsets = RNG.normal(scale=[2.5, 2.5], size=(30000, 2))
    found = normalised_error(np.hypot(*offsets.T), np.ones(30000), np.ones(30000, bool))
    assert found == pytest.approx(np.sqrt((offsets**2).mean()))


@pytest.mark.parametrize("level", LEVELS)
def test_circles_hold_their_share(level):
    assert coverage(ERRORS, SIGMA, ALL, level) == pytest.approx(level, abs=0.01)


def test_the_median_does_not_mind_gross_errors():
    wild = np.where(RNG.random(40000) < 0.02, 500.0, ERRORS)
    assert normalised_error(wild, SIGMA, ALL) > 5.0
    assert median_normalised_error(wild, SIGMA, ALL) == pytest.approx(1.0, rel=0.05)


def test_what_does_not_count_is_not_read():
    counted = ALL.copy()
    counted[::2] = False
    spoilt = np.where(counted, ERRORS, np.nan)
    assert np.isfinite(normalised_error(spoilt, SIGMA, counted))
    assert np.isfinite(coverage(spoilt, SIGMA, counted, 0.5))
    for measure in (normalised_error, median_normalised_error):
        assert np.isnan(measure(ERRORS, SIGMA, ~ALL))


def test_auroc_counts_pairs():
    high, low = RNG.integers(3, 12, 40).astype(float), RNG.integers(0, 10, 30).astype(float)
    pairs = high[:, None] - low
    expected = np.mean((pairs > 0) + 0.5 * (pairs == 0))
    assert auroc(high, low) == pytest.approx(expected)
    assert auroc(np.ones(3), np.zeros(5)) == 1.0
    assert auroc(np.ones(3), np.ones(5)) == 0.5
    assert np.isnan(auroc(np.ones(3), np.zeros(0)))


def test_honest_probabilities_are_reliable():
    p = RNG.random(50000)
    happened = RNG.random(50000) < p
    assert calibration_error(p, happened) < 0.01
    assert calibration_error(p**2, happened) > 0.1
    rows = reliability(np.array([0.05, 0.07, 1.0]), np.array([True, False, True]))
    assert rows == [(pytest.approx(0.06), 0.5, 2), (1.0, 1.0, 1)]
