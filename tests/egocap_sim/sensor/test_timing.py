"""Motion blur and rolling shutter of a bar that moves at a known speed."""

import numpy as np
import pytest

from egocap_sim.sensor.timing import Exposure, exposure, instants

from .oracles import add_subframe

HEIGHT, WIDTH = 60, 200
SPEED = 1000.0  # px/s


def bar(time: float) -> np.ndarray:
    """A white bar, 4 px wide, whose left edge is at 80 px + SPEED * time."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    left = round(80 + SPEED * time)
    image[:, left : left + 4] = 255
    return image


def plan_of(middle: float, shutter_s: float, readout_s: float, count: int) -> Exposure:
    rendered = instants(np.array([middle]), shutter_s, readout_s, count)
    return exposure(middle, HEIGHT, shutter_s, readout_s, rendered)


def picture(shutter_s: float, readout_s: float, count: int, middle: float = 0.0) -> np.ndarray:
    """Linear light (H, W) of the bar."""
    plan = plan_of(middle, shutter_s, readout_s, count)
    light = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for i, time in enumerate(plan.times):
        add_subframe(light, bar(time), plan.weights[:, i])
    return light[..., 0]


def centroid(rows: np.ndarray) -> np.ndarray:
    return (rows * np.arange(WIDTH)).sum(-1) / rows.sum(-1)


@pytest.mark.parametrize("shutter_s", [0.0, 1 / 60])
@pytest.mark.parametrize("readout_s", [0.0, 0.02])
@pytest.mark.parametrize("count", [1, 2, 9, 33])
def test_rows_gather_all_their_light(shutter_s, readout_s, count):
    plan = plan_of(1.0, shutter_s, readout_s, count)
    assert np.allclose(plan.weights.sum(1), 1)
    assert (plan.weights >= 0).all()
    assert plan.times.mean() == pytest.approx(1.0)


@pytest.mark.parametrize("shutter_s", [0.01, 0.02, 0.04])
def test_blur_is_as_long_as_speed_times_shutter(shutter_s):
    blurred = picture(shutter_s, 0.0, 65)
    lit = np.flatnonzero(blurred[30] > 1e-4)
    assert lit[-1] - lit[0] + 1 == pytest.approx(4 + SPEED * shutter_s, abs=1.5)
    assert blurred[30].sum() == pytest.approx(4.0)  # spread out, not more
    assert centroid(blurred[30]) == pytest.approx(81.5, abs=0.1)


def test_rolling_shutter_skews_by_speed_times_readout():
    skewed = picture(0.0, 0.03, 61)
    x = centroid(skewed)
    slope = np.polyfit(np.arange(HEIGHT), x, 1)[0]
    assert slope * HEIGHT == pytest.approx(SPEED * 0.03, rel=0.03)
    assert x[HEIGHT // 2] == pytest.approx(81.5, abs=1.0)
    assert np.all(np.count_nonzero(skewed, axis=1) == 4)  # sharp: no shutter time


def test_blur_and_rolling_shutter_together():
    both = picture(0.02, 0.03, 65)
    x = centroid(both)
    assert np.polyfit(np.arange(HEIGHT), x, 1)[0] * HEIGHT == pytest.approx(30, rel=0.05)
    for row in (0, 30, 59):
        assert np.count_nonzero(both[row] > 1e-4) == pytest.approx(24, abs=2)


def test_labels_come_whole_from_the_nearest_subframe():
    plan = plan_of(0.0, 0.02, 0.03, 3)
    assert list(np.unique(plan.nearest)) == [0, 1, 2]
    assert (np.diff(plan.nearest) >= 0).all()
    for i in range(3):
        rows = np.arange(HEIGHT)[plan.rows(i)]
        assert set(np.flatnonzero(plan.weights[:, i])) <= set(rows)
        assert set(np.flatnonzero(plan.nearest == i)) <= set(rows)


def test_one_subframe_is_the_middle_instant():
    plan = plan_of(2.5, 0.0, 0.0, 1)
    assert list(plan.times) == [2.5] and (plan.weights == 1).all()


def test_views_whose_exposures_overlap_share_their_instants():
    """And each still gathers the light of its own time: the bar's centroid tells which."""
    middle = np.array([0.0, 0.008])
    rendered = instants(middle, 1 / 60, 0.0, 65)
    assert len(rendered.times) == 65
    for time in middle:
        plan = exposure(time, HEIGHT, 1 / 60, 0.0, rendered)
        assert np.allclose(plan.weights.sum(1), 1)
        light = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        for i, t in enumerate(plan.times):
            add_subframe(light, bar(t), plan.weights[:, i])
        assert centroid(light[30, :, 0]) == pytest.approx(81.5 + SPEED * time, abs=0.2)


def test_views_that_expose_one_after_the_other_have_their_own_instants():
    rendered = instants(np.array([0.0, 0.1]), 0.01, 0.0, 3)
    assert len(rendered.times) == 6
    early = exposure(0.0, HEIGHT, 0.01, 0.0, rendered)
    assert (early.weights[:, 3:] == 0).all() and np.allclose(early.weights[:, :3], 1 / 3)
