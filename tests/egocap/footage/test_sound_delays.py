"""Drift from waveforms of two microphones a head apart, whose clocks are planted."""

import numpy as np
import pytest

from egocap.footage.sound_delays import delays, residual_drift
from egocap.media.sound import RATE, Soundtrack

SECONDS, START = 12, 0.4
HEAD_S = 0.5e-3  # sound from the side reaches one microphone so much earlier, either way


def tracks(offset, drift, apart=0.0, noise=0.02, gain=0.5, seed=0):
    """Two recordings of bursts around the head; own time of b to that of a by offset and drift."""
    rng = np.random.default_rng(seed)
    time = np.arange(SECONDS * RATE) / RATE
    fine = np.arange((SECONDS + 8) * 2 * RATE) / (2 * RATE) - 3.0
    a, b = np.zeros_like(time), np.zeros_like(time)
    for at in np.arange(-1.0, SECONDS + 2.0, 0.35):
        burst = np.zeros_like(fine)
        inside = (fine > at) & (fine < at + 0.15)
        burst[inside] = rng.normal(0.0, 0.3, inside.sum())
        burst = np.convolve(burst, [0.25, 0.5, 0.25], "same")
        a += np.interp(time, fine, burst)
        common = offset + (1.0 + drift) * (START + time)
        b += np.interp(common + rng.uniform(-apart, apart), fine, burst)
    b *= gain
    made = [v + rng.normal(0.0, noise, len(v)) for v in (a, b)]
    return [Soundtrack(t, (8000 * v).clip(-32767, 32767).astype(np.int16))
            for t, v in zip((0.0, START), made, strict=True)]  # fmt: skip


@pytest.mark.parametrize(("offset", "drift"), [(0.0, 0.0), (0.71, 55e-6), (-0.33, -80e-6)])
def test_delays_are_those_of_the_clocks_within_microseconds(offset, drift):
    a, b = tracks(offset, drift)
    found = delays(a, b, offset - 0.002, drift)
    assert len(found.time) > 30
    np.testing.assert_allclose(found.delay, 0.002, atol=2e-5)
    left, std = residual_drift(a, b, offset - 0.002, 0.0)
    assert left == pytest.approx(drift, abs=3e-6) and std < 15e-6


def test_sources_around_the_head_raise_the_uncertainty_that_is_stated():
    errors = []
    for seed in range(8):
        left, std = residual_drift(*tracks(0.2, 30e-6, apart=HEAD_S, seed=seed), 0.2, 0.0)
        assert std > 8e-6
        errors.append((left - 30e-6) / std)
    assert 0.3 < np.std(errors) < 2.0


def test_what_is_not_alike_gives_no_drift():
    a, b = tracks(0.0, 0.0)[0], tracks(0.0, 0.0, seed=1)[1]
    assert residual_drift(a, b, 0.0, 0.0) is None
    silent = Soundtrack(0.0, np.zeros(SECONDS * RATE, np.int16))
    assert residual_drift(a, silent, 0.0, 0.0) is None
    assert residual_drift(a, Soundtrack(0.0, a.samples[: 3 * RATE // 2]), 0.0, 0.0) is None
