"""Error bars against scipy and against draws of a known distribution."""

import numpy as np
import pytest
from scipy import stats

from egocap_eval.harness.intervals import format_interval, mean_and_interval, share_and_interval


def test_mean_is_scipys():
    values = [1.0, 4.0, 2.0, 8.0]
    found = mean_and_interval([*values, None])
    low, high = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert found == {"mean": pytest.approx(3.75), "half_interval": pytest.approx((high - low) / 2)}


def test_one_draw_has_no_interval():
    assert mean_and_interval([3.0, None]) is None
    assert format_interval(None) == "-"


def test_intervals_hold_the_mean_as_often_as_they_claim():
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(1000):
        found = mean_and_interval(list(rng.normal(5.0, 2.0, 4)))
        held += abs(found["mean"] - 5.0) <= found["half_interval"]
    assert 935 <= held <= 965


@pytest.mark.parametrize("successes", [0, 3, 20])
def test_share_is_scipys(successes):
    found = share_and_interval(successes, 20)
    known = stats.binomtest(successes, 20).proportion_ci(method="wilson")
    assert found["percent"] == pytest.approx(5.0 * successes)
    assert (found["low"], found["high"]) == pytest.approx((100 * known.low, 100 * known.high))
