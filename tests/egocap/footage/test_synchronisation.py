"""Clocks from signals whose lag and drift are known, and honest failures."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from egocap.footage.signals import (
    ViewSignal,
    ViewSignals,
    light_signal,
    rotation_signal,
    sound_signal,
)
from egocap.footage.synchronisation import coarse_lag, estimate_clock, refine_clock

FPS = 29.97


class Head:
    """Random smooth rotation angles of a head; three axes."""

    def __init__(self, seconds: float, rate: float = 1.0, seed: int = 0, knot=0.15) -> None:
        rng = np.random.default_rng(seed)
        knots = np.arange(-2.0, seconds + 2.0, knot)
        self.angle = CubicSpline(knots, rng.normal(0.0, 0.06 * rate, (len(knots), 3)))

    def seen(self, seconds, offset=0.0, drift=0.0, noise=1e-4, seed=1, lost=(), repeated=()):
        """Own times, rotations between pictures and fresh mask of a view's camera."""
        rng = np.random.default_rng(seed)
        own = np.delete(np.arange(int(seconds * FPS)) / FPS, list(lost))
        shown = own.copy()
        shown[list(repeated)] = own[np.array(repeated, int) - 1]
        angle = self.angle(offset + (1.0 + drift) * shown)
        turn = np.diff(angle, axis=0, prepend=angle[:1]) + rng.normal(0.0, noise, angle.shape)
        fresh = np.ones(len(own), bool)
        fresh[list(repeated)] = False
        turn[~fresh] = 0.0
        return rotation_signal(own, turn, fresh)


def dark(seconds):
    time = np.arange(int(seconds * FPS)) / FPS
    rng = np.random.default_rng(5)
    return light_signal(time, 100.0 + rng.normal(0, 0.5, len(time)), np.ones(len(time), bool))


def estimate(first, other, light=None, sound=(None, None)):
    lights = light or (dark(60), dark(60))
    return estimate_clock(
        *(ViewSignals(*s) for s in zip((first, other), lights, sound, strict=True))
    )


@pytest.mark.parametrize("offset", [0.0, 0.0123, -1.487, 3.3021])
def test_lag_within_a_twentieth_of_a_frame(offset):
    head = Head(40)
    first, other = head.seen(30), head.seen(25, offset, seed=2)
    timing = estimate(first, other).timing
    assert timing.origin == "estimated"
    assert timing.offset_s == pytest.approx(offset, abs=1.5e-3)
    assert abs(timing.offset_s - offset) < 4 * timing.offset_std_s < 6e-3


def test_drift_within_its_stated_uncertainty():
    head, errors = Head(130), []
    for seed in range(6):
        other = head.seen(120, 0.21, 45e-6, noise=3e-4, seed=10 + seed)
        timing = estimate(head.seen(125, noise=3e-4, seed=20 + seed), other).timing
        errors.append((timing.drift_ppm - 45) / timing.drift_std_ppm)
        assert abs(timing.drift_ppm - 45) < 20
    assert np.sqrt(np.mean(np.square(errors))) < 2.5


def test_a_slow_heads_lag_within_its_stated_uncertainty():
    """The slopes of slow rates are mostly noise, which must not count as signal."""
    errors = []
    for seed in range(30):
        head = Head(14, seed=seed, knot=0.8)
        first = head.seen(11, noise=1e-3, seed=100 + seed)
        timing = estimate(first, head.seen(10, 0.5, noise=1e-3, seed=200 + seed)).timing
        middle = timing.offset_s + 5e-6 * timing.drift_ppm
        errors.append((middle - 0.5) / timing.offset_std_s)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.4


@pytest.mark.parametrize(("offset", "origin"), [(0.5, "estimated"), (0.0, "assumed")])
def test_a_rough_lag_is_used_where_it_is_certainly_not_0(offset, origin):
    head = Head(8, seed=1, knot=0.8)
    found = estimate(head.seen(5, noise=2e-3), head.seen(4.2, offset, noise=2e-3, seed=2))
    assert "uncertain by" in found.problem and found.timing.origin == origin
    assert found.timing.offset_s == pytest.approx(offset, abs=0.05)


def test_short_footage_leaves_the_drift_to_the_prior():
    head = Head(12)
    first, other = head.seen(10, noise=2e-3), head.seen(8, 0.5, 40e-6, noise=2e-3, seed=2)
    timing = estimate(first, other).timing
    assert timing.offset_s == pytest.approx(0.5, abs=2e-3)
    assert abs(timing.drift_ppm) < 100 and timing.drift_std_ppm > 10


def test_lost_repeated_and_unmeasured_pictures():
    head = Head(30)
    first = head.seen(25, lost=(100, 101, 300), repeated=(50, 400))
    other = head.seen(25, 0.333, lost=(7, 222), repeated=(90,), seed=3)
    assert estimate(first, other).timing.offset_s == pytest.approx(0.333, abs=1.5e-3)
    time = np.arange(200) / FPS
    turn = np.full((200, 3), 0.01)
    turn[50] = np.nan
    signal = rotation_signal(time, turn, np.ones(200, bool))
    assert len(signal.time) == 198 and np.isfinite(signal.rate).all()
    np.testing.assert_allclose(signal.rate, 0.01 * FPS)


def test_the_wearers_body_in_one_view_is_an_outlier():
    """For a fifth of the time one view follows something else."""
    head, body = Head(40), Head(40, seed=9)
    first = head.seen(30)
    other, wrong = head.seen(30, 0.1, seed=4), body.seen(30, 0.1, seed=5)
    rate = other.rate.copy()
    rate[200:380] = wrong.rate[200:380]
    timing = estimate(first, ViewSignal(other.time, rate)).timing
    assert timing.offset_s == pytest.approx(0.1, abs=3e-3)


def test_a_head_at_rest_gives_no_clock_and_says_so():
    head = Head(30, rate=0.005)
    found = estimate(head.seen(25), head.seen(25, 0.4, seed=2))
    assert found.timing.origin == "assumed" and found.timing.offset_s == 0.0
    assert "the head hardly turns" in found.timing.note


def test_views_of_different_heads_do_not_agree():
    found = estimate(Head(30, seed=1).seen(25), Head(30, seed=2).seen(25))
    assert found.timing.origin == "assumed" and "do not agree" in found.timing.note


def test_periodic_motion_is_ambiguous():
    time = np.arange(600) / FPS
    turn = 0.03 * np.sin(2 * np.pi * time)[:, None] * [1.0, 0.3, 0.0]
    signal = rotation_signal(time, turn, np.ones(600, bool))
    found = estimate(signal, signal)
    assert found.timing.origin == "assumed" and "several lags" in found.timing.note


def test_a_flash_gives_the_clock_of_a_head_at_rest():
    time = np.arange(400) / FPS
    rng = np.random.default_rng(0)

    def lit(offset):
        flashes = sum(np.exp(-np.maximum(time + offset - at, 0) / 0.3) * (time + offset > at)
                      for at in (4.0, 6.3))  # fmt: skip
        return light_signal(time, 80 * (1 + flashes) + rng.normal(0, 0.2, 400),
                            np.ones(400, bool))  # fmt: skip

    head = Head(30, rate=0.005)
    found = estimate(head.seen(13), head.seen(13, 0.8), (lit(0.0), lit(0.8)))
    assert found.source == "light"
    assert found.timing.offset_s == pytest.approx(0.8, abs=0.02)


def test_the_reversed_roles_invert_the_clock():
    head = Head(40)
    a, b = head.seen(30), head.seen(30, 0.9, 30e-6, seed=2)
    offset, drift, _ = refine_clock(a, b, coarse_lag(a, b)[0])
    back, rate, _ = refine_clock(b, a, coarse_lag(b, a)[0])
    assert back == pytest.approx(-offset, abs=1e-3)
    assert rate == pytest.approx(-drift, abs=5e-5)


def heard(seconds, offset=0.0, drift=0.0, gain=1.0, seed=1, bursts=40):
    """Loudness of sounds of a scene, by a file whose clock differs."""
    events = np.random.default_rng(9)
    at, loud = events.uniform(-5, 40, bursts), events.uniform(0.2, 1.0, bursts)
    own = np.arange(int(seconds / 0.002)) * 0.002
    since = (offset + (1.0 + drift) * own)[:, None] - at
    since = since.clip(0)
    sound = (loud * np.exp(-since / 0.05) * -np.expm1(-since / 0.005)).sum(1)
    own_noise = np.random.default_rng(seed).uniform(0.8, 1.2, len(own))
    return sound_signal(own, gain * sound + 0.01 * own_noise)


def test_sound_gives_the_clock_where_the_head_is_still():
    still = Head(40, rate=0.0)
    sound = heard(30), heard(28, 1.234, 30e-6, gain=0.3, seed=2)
    found = estimate(still.seen(30), still.seen(28, 1.234, seed=2), sound=sound)
    assert found.source == "sound" and "from sound" in found.timing.note
    assert found.timing.offset_s == pytest.approx(1.234, abs=2e-3)
    assert found.timing.drift_ppm == pytest.approx(30, abs=3 * found.timing.drift_std_ppm)
    assert found.timing.offset_std_s > 2e-3  # sound and pictures of a file lie apart


def test_sound_improves_the_drift_and_leaves_the_lag_to_the_pictures():
    head = Head(40)
    first, other = head.seen(30, noise=2e-3), head.seen(28, 0.5, 45e-6, noise=2e-3, seed=2)
    sound = heard(30), heard(28, 0.5 + 0.012, 45e-6, gain=2.0, seed=2)  # 12 ms behind
    alone, both = estimate(first, other).timing, estimate(first, other, sound=sound).timing
    assert both.drift_std_ppm < 0.7 * alone.drift_std_ppm
    assert both.drift_ppm == pytest.approx(45, abs=20)
    middle = 14.0
    np.testing.assert_allclose(both.to_common(middle), alone.to_common(middle), atol=2e-4)
    assert "drift from sound, +12" in both.note or "drift from sound, +11" in both.note


def test_sound_of_another_occasion_changes_nothing():
    head = Head(40)
    first, other = head.seen(30), head.seen(28, 0.5, seed=2)
    sound = heard(30), heard(28, 3.5, seed=2)
    alone, both = estimate(first, other).timing, estimate(first, other, sound=sound).timing
    assert both.offset_s == alone.offset_s and both.drift_ppm == alone.drift_ppm
    assert "sound tracks lie +3000 ms apart" in both.note
