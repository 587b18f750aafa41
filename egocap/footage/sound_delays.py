"""Drift between two sound tracks whose clocks are roughly known, from their waveforms.

Short pieces of one track are correlated with the other's. The delays of the loud ones lie on a
line over time, whose slope is the drift. Microphones of one rig lie up to a millisecond of sound
apart, so that sources at different places scatter the delays: the standard deviation is that of
the scatter found.

Source: time delay by generalised cross-correlation, Knapp & Carter 1976; M-estimator with the
biweight, Huber & Ronchetti 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.media.sound import RATE, Soundtrack

PIECE = 4096  # samples, 0.26 s
SEARCH = 96  # samples: 6 ms either way
LEAST_PIECES = 8
LEAST_LIKENESS = 0.3  # normalised correlation at the delay
FLOOR_S = 3e-5  # of a delay: a source that moves around the head
_LOW_HZ, _HIGH_HZ = 150.0, 6000.0  # hum below, lossy compression above
_FINER = 8  # samples of the correlation for one of the sound
_ROUNDS = 20


class Delays(NamedTuple):
    """Delays of pieces of a track against their expected times."""

    time: Float[Array, "n"]  # s, own clock of the piece's track
    delay: Float[Array, "n"]  # s, common time less expected common time


def residual_drift(
    a: Soundtrack, b: Soundtrack, offset: float, drift: float
) -> tuple[float, float] | None:
    """Drift left between the tracks, and its standard deviation.

    `offset` [s] and `drift` take b's clock to a's up to a few milliseconds. None where too few
    pieces of the tracks are alike.
    """
    found = delays(a, b, offset, drift)
    if len(found.time) < LEAST_PIECES:
        return None
    inlier = np.abs(found.delay - np.median(found.delay)) < 2e-3
    if inlier.sum() < max(LEAST_PIECES, 0.5 * len(inlier)):
        return None
    return _slope(found.time[inlier], found.delay[inlier])


def delays(a: Soundtrack, b: Soundtrack, offset: float, drift: float) -> Delays:
    """Delay of every piece of b that is found in a."""
    count = len(b.samples) // PIECE
    starts = np.arange(count) * PIECE
    middle = b.start + (starts + 0.5 * PIECE) / RATE
    wanted = (offset + (1.0 + drift) * middle - a.start) * RATE - 0.5 * PIECE
    first = np.rint(wanted).astype(int)
    inside = (first >= SEARCH) & (first + PIECE + SEARCH <= len(a.samples))
    rows = [
        (time, (shift + at - want) / RATE)
        for start, at, want, time in zip(starts[inside], first[inside], wanted[inside],
                                         middle[inside], strict=True)
        if (shift := _shift(a.samples[at - SEARCH : at + PIECE + SEARCH],
                            b.samples[start : start + PIECE])) is not None
    ]  # fmt: skip
    time, delay = np.reshape(rows, (-1, 2)).T
    return Delays(time, delay)


def _shift(longer: Array, piece: Array) -> float | None:
    """Place of a piece in a longer one, from its middle, samples; None where it is not found."""
    size = 2 * PIECE
    padded = np.zeros(len(longer))
    padded[SEARCH : SEARCH + PIECE] = piece
    x, y = (np.fft.rfft(v - v.mean(), size) * _BAND for v in (longer.astype(float), padded))
    power = np.sqrt((np.abs(x) ** 2).sum() * (np.abs(y) ** 2).sum())
    if power <= 0.0:
        return None
    cross = x * np.conj(y)
    score = np.fft.irfft(cross, size * _FINER) * (size * _FINER / 2.0) / power
    reach = SEARCH * _FINER
    near = np.concatenate([score[-reach:], score[: reach + 1]])
    best = int(near.argmax())
    if near[best] < LEAST_LIKENESS or best in (0, 2 * reach):
        return None
    left, top, right = near[best - 1 : best + 2]
    return (best - reach + 0.5 * (left - right) / (left - 2.0 * top + right)) / _FINER


def _band() -> Bool[Array, "n"]:
    hertz = np.fft.rfftfreq(2 * PIECE, 1.0 / RATE)
    return np.asarray((hertz > _LOW_HZ) & (hertz < _HIGH_HZ))


_BAND = _band()


def _slope(time: Float[Array, "n"], delay: Float[Array, "n"]) -> tuple[float, float]:
    """Slope of the delays and its standard deviation."""
    A = np.stack([np.ones(len(time)), time - time.mean()], 1)
    weight = np.ones(len(time))
    for _ in range(_ROUNDS):
        H = A.T @ (weight[:, None] * A)
        line = np.linalg.solve(H, A.T @ (weight * delay))
        off = delay - A @ line
        scale = max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        weight = np.maximum(1.0 - (off / (4.7 * scale)) ** 2, 0.0) ** 2
    spread = np.sqrt((weight * off**2).sum() / max(weight.sum() - 2.0, 1.0))
    inverse = np.linalg.inv(H)
    span = float(np.sqrt(np.average(A[:, 1] ** 2, weights=weight)))
    return float(line[1]), float(np.hypot(spread * np.sqrt(inverse[1, 1]), FLOOR_S / span))
