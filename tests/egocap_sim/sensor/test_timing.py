"""Motion blur and rolling shutter of a bar that moves at a known speed."""

import numpy as np
import pytest

from egocap_sim.sensor.timing import add_rows, add_subframe, exposure

HEIGHT, WIDTH = 60, 200
SPEED = 1000.0  # px/s


def bar(time: float) -> np.ndarray:
    """A white bar, 4 px wide, whose left edge is at 80 px + SPEED * time."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    left = round(80 + SPEED * time)
    image[:, left : left + 4] = 255
    return image


def picture(shutter_s: float, readout_s: float, count: int, middle: float = 0.0) -> np.ndarray:
    """Linear light (H, W) of the bar."""
    plan = exposure(middle, HEIGHT, shutter_s, readout_s, count)
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
    plan = exposure(1.0, HEIGHT, shutter_s, readout_s, count)
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
    plan = exposure(0.0, HEIGHT, 0.02, 0.03, 3)
    plane = np.zeros((HEIGHT, WIDTH), np.uint8)
    for i in range(3):
        add_rows(plane, np.full((HEIGHT, WIDTH), 10 + i, np.uint8), plan.nearest == i)
    assert list(np.unique(plane)) == [10, 11, 12]
    assert (np.diff(plane[:, 0].astype(int)) >= 0).all()


def test_one_subframe_is_the_middle_instant():
    plan = exposure(2.5, HEIGHT, 0.0, 0.0, 1)
    assert list(plan.times) == [2.5] and (plan.weights == 1).all()
