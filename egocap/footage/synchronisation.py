"""Clocks of views from what they have in common: head rotation, sound, or changes of the light.

Angular rates of two views, or changes of their loudness, are correlated for a coarse lag. Lag and
drift then minimise the robust difference of the rates, with a prior on the drift of crystals.
Standard deviations are those of a sandwich estimator over blocks of a second, since errors of
neighbouring samples are alike.

Source: Huber & Ronchetti 2009, ch. 7 (M-estimators and their covariance).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.data.footage import ViewTiming
from egocap.footage.signals import ViewSignal, ViewSignals
from egocap.footage.sound_delays import residual_drift
from egocap.media.sound import Soundtrack
from egocap.series import interpolate

DRIFT_PRIOR_PPM = 60.0  # standard deviation of the difference of two crystals
LEAST_CORRELATION = 0.5
LEAST_OVERLAP_S = 3.0
STILL_RAD_S = 0.03  # rate of a head at rest, with the noise of its measurement
MOST_STD_S = 0.010  # of a lag that is sure
ROUGH_STD_S = 0.1  # of a lag that is better than none where it differs from none
RIVAL = 0.97  # of the highest peak of the correlation: another lag explains the views as well
WHAT = {"rotation": "the rotation of the head", "sound": "sound", "light": "changes of the light"}
SOUND_STD_S = 0.003  # by which the sound of two cameras of one kind lies apart from their pictures
SOUND_FAR_S = 0.1  # from the pictures: not the same sound
_SMOOTH = 1.0  # standard deviation of the smoothing, frames
_ALIKE = 2.0 * 2.0 * np.pi**0.5 * _SMOOTH  # two comparisons of the same smoothed noise
_BLOCK_S = 1.0
_ONSET_S = 1e-4  # by which the beginnings of sounds differ between microphones
_ROUNDS = 12
_FLOOR_S = 3e-4  # standard deviation of what the model leaves out: rolling shutter, exposure


@dataclass(frozen=True, eq=False)
class ClockEstimate:
    """The clock of a view against another's, and how it was found."""

    timing: ViewTiming
    correlation: float  # of the two signals, aligned; nan without any
    source: str  # 'rotation', 'sound', 'light' or 'none'
    problem: str = ""  # why the clock could not be estimated, or not for sure


def estimate_clock(first: ViewSignals, other: ViewSignals) -> ClockEstimate:
    """Clock of the other view, with the first's as the common one.

    Head rotation decides, and sound improves its drift; without enough rotation, sound, then sudden
    changes of the light (a flash, a lamp). Where none is sure, a rough lag that is certainly not 0.
    """
    found = {"rotation": _estimate(first.rotation, other.rotation, "rotation")}
    if first.sound is not None and other.sound is not None:
        found["sound"] = _from_sound(first, other)
    turned = found["rotation"]
    if not turned.problem:
        return _with_drift(turned, found.get("sound", turned), float(other.rotation.time.mean()))
    if "sound" not in found or found["sound"].problem:
        found["light"] = _estimate(first.light, other.light, "light")
    for estimate in found.values():
        if not estimate.problem:
            return estimate
    for estimate in found.values():
        std = estimate.timing.offset_std_s
        if std is not None and std < ROUGH_STD_S and abs(estimate.timing.offset_s) > 3.0 * std:
            return estimate
    problem = "; ".join(f"{source}: {estimate.problem}" for source, estimate in found.items())
    return ClockEstimate(ViewTiming(note=problem), next(reversed(found.values())).correlation,
                         "none", problem)  # fmt: skip


def _from_sound(first: ViewSignals, other: ViewSignals) -> ClockEstimate:
    """As `_estimate`, with the drift of the waveforms; sound and pictures may lie apart."""
    a, b = first.sound, other.sound
    assert a is not None and b is not None
    found = _estimate(a, b, "sound")
    if found.problem:
        return found
    timing = found.timing
    assert timing.offset_std_s is not None and timing.drift_std_ppm is not None
    drift, std = timing.drift_ppm, 1e6 * _ONSET_S * 12**0.5 / _duration(b)
    std = float(np.hypot(timing.drift_std_ppm, std))
    finer = _waveform_drift(first.waveform, other.waveform, timing)
    if finer is not None and finer[1] < std:
        drift, std = drift + finer[0], finer[1]
    return replace(found, timing=timing.model_copy(update={
        "offset_s": timing.offset_s + 1e-6 * float(b.time.mean()) * (timing.drift_ppm - drift),
        "offset_std_s": float(np.hypot(timing.offset_std_s, SOUND_STD_S)),
        "drift_ppm": drift, "drift_std_ppm": std,
    }))  # fmt: skip


def _waveform_drift(
    a: Soundtrack | None, b: Soundtrack | None, timing: ViewTiming
) -> tuple[float, float] | None:
    """Drift beyond that of a clock, and its standard deviation [ppm]."""
    if a is None or b is None:
        return None
    found = residual_drift(a, b, timing.offset_s, 1e-6 * timing.drift_ppm)
    return None if found is None else (1e6 * found[0], 1e6 * found[1])


def _with_drift(turned: ClockEstimate, heard: ClockEstimate, middle: float) -> ClockEstimate:
    """The lag of the one at the middle of the footage, and the drift of the surer one."""
    timing, sound = turned.timing, heard.timing
    if heard.source != "sound":
        return turned
    assert timing.offset_std_s is not None and timing.drift_std_ppm is not None
    assert sound.drift_std_ppm is not None
    at = np.array([middle])
    apart = float((sound.to_common(at) - timing.to_common(at))[0])
    if abs(apart) > SOUND_FAR_S:
        note = f"{timing.note}; the sound tracks lie {1e3 * apart:+.0f} ms apart from that"
        return replace(turned, timing=timing.model_copy(update={"note": note}))
    if sound.drift_std_ppm >= timing.drift_std_ppm:
        return turned
    away = 1e-6 * middle
    std_middle = np.sqrt(
        max(timing.offset_std_s**2 - (away * timing.drift_std_ppm) ** 2, _FLOOR_S**2)
    )
    return replace(turned, timing=timing.model_copy(update={
        "offset_s": timing.offset_s + away * (timing.drift_ppm - sound.drift_ppm),
        "offset_std_s": float(np.hypot(std_middle, away * sound.drift_std_ppm)),
        "drift_ppm": sound.drift_ppm, "drift_std_ppm": sound.drift_std_ppm,
        "note": f"{timing.note}; drift from sound, {1e3 * apart:+.1f} ms apart",
    }))  # fmt: skip


def _estimate(a: ViewSignal, b: ViewSignal, source: str) -> ClockEstimate:
    def failed(problem: str, correlation: float = np.nan) -> ClockEstimate:
        return ClockEstimate(ViewTiming(), correlation, "none", problem)

    if min(_duration(a), _duration(b)) < LEAST_OVERLAP_S:
        return failed(f"less than {LEAST_OVERLAP_S:g} s")
    if source == "rotation" and min(_activity(a), _activity(b)) < STILL_RAD_S:
        return failed("the head hardly turns")
    if source != "rotation" and min(_peak(a), _peak(b)) < 12.0:
        return failed("no sudden change")
    lag, correlation, rival = coarse_lag(a, b)
    if not correlation > LEAST_CORRELATION:
        return failed(f"the views do not agree (correlation {correlation:.2f})", correlation)
    if rival > RIVAL * correlation:
        return failed("several lags fit as well", correlation)
    offset, drift, cov = refine_clock(a, b, lag)
    std = np.sqrt(np.diag(cov))
    middle = float(b.time.mean())
    std_middle = float(np.sqrt(max(np.array([1.0, middle]) @ cov @ [1.0, middle], 0.0)))
    unsure = f"the lag is uncertain by {1e3 * std_middle:.0f} ms"
    timing = ViewTiming(
        offset_s=offset, drift_ppm=1e6 * drift, offset_std_s=float(np.hypot(std[0], _FLOOR_S)),
        drift_std_ppm=float(1e6 * std[1]), origin="estimated",
        note=f"from {WHAT[source]}, correlation {correlation:.2f}",
    )  # fmt: skip
    return ClockEstimate(timing, correlation, source, unsure if std_middle > MOST_STD_S else "")


def coarse_lag(a: ViewSignal, b: ViewSignal) -> tuple[float, float, float]:
    """Common time less own time of view b [s]; the correlation there; that of its best rival.

    Every lag is tried for which the views overlap by `LEAST_OVERLAP_S`.
    """
    step = min(float(np.median(np.diff(a.time))), float(np.median(np.diff(b.time))))
    x, y = _on_grid(a, step), _on_grid(b, step)
    size = 1 << int(np.ceil(np.log2(len(x) + len(y))))

    def correlate(p: Array, q: Array) -> Array:
        spectrum = np.fft.rfft(p, size, axis=0) * np.conj(np.fft.rfft(q, size, axis=0))
        return np.fft.irfft(spectrum, size, axis=0).sum(-1)

    ones_x, ones_y = np.ones((len(x), 1)), np.ones((len(y), 1))
    power_x = correlate((x**2).sum(1, keepdims=True), ones_y)
    power_y = correlate(ones_x, (y**2).sum(1, keepdims=True))
    common = np.maximum(np.rint(correlate(ones_x, ones_y)), 0.0)
    enough = min(LEAST_OVERLAP_S / step, 0.8 * min(len(x), len(y)))
    scale = np.sqrt(np.maximum(power_x * power_y, 1e-12))
    # Fewer common samples agree more easily by chance.
    score = correlate(x, y) / scale * np.sqrt(common / (common + LEAST_OVERLAP_S / step))
    score = np.where(common > enough - 0.5, score, -1.0)
    best = int(score.argmax())
    shift = (np.arange(size) + size // 2) % size - size // 2
    apart = np.abs(shift - shift[best]) * step > 0.25
    lag = shift[best] * step + a.time[0] - b.time[0]
    true = float(correlate(x, y)[best] / scale[best])
    return float(lag), true, true * float(score[apart].max(initial=-1.0) / score[best])


def refine_clock(
    a: ViewSignal, b: ViewSignal, lag: float
) -> tuple[float, float, Float[Array, "2 2"]]:
    """Offset [s] and drift of view b's clock against a's, and their covariance.

    Rates of each view are compared with the spline of the other's, so that the noise of neither
    draws the estimate.
    """
    sa, sb = _smoothed(a), _smoothed(b)
    centre = float(b.time.mean())  # offset and drift are independent about the middle
    clock = np.array([centre + lag, 0.0])  # common time at the centre; drift
    model = _linearised(sa, sb, centre, clock)
    for _ in range(_ROUNDS):
        step = np.linalg.solve(model.H, model.gradient.sum(0) - model.prior @ [0.0, clock[1]])
        clock = clock + step
        if abs(step[0]) < 1e-7:
            break
        model = _linearised(sa, sb, centre, clock)
    shift = np.array([[1.0, -centre], [0.0, 1.0]])  # from the middle of the footage to time zero
    cov = shift @ _sandwich(model) @ shift.T
    return float(clock[0] - (1.0 + clock[1]) * centre), float(clock[1]), cov


class _Linearised(NamedTuple):
    """The weighted least-squares problem of a step in the clock at the centre and the drift."""

    H: Float[Array, "2 2"]
    curved: Float[Array, "2 2"]  # H with second derivatives: free of slopes' noise
    gradient: Float[Array, "n 2"]  # of every sample
    when: Float[Array, "n"]  # s, from the centre
    prior: Float[Array, "2 2"]  # the part of H that the prior adds
    variance: float  # of a residual


def _linearised(
    a: ViewSignal, b: ViewSignal, centre: float, clock: Float[Array, "2"]
) -> _Linearised:
    from scipy.interpolate import CubicSpline

    middle, drift = clock
    common = middle + (1.0 + drift) * (b.time - centre)
    own = centre + (a.time - middle) / (1.0 + drift)
    parts = []
    for rate, seen, at, when, sign in (
        (b.rate, a, common, b.time - centre, 1.0), (a.rate, b, own, own - centre, -1.0),
    ):  # fmt: skip
        spline = CubicSpline(seen.time, seen.rate)
        inside = (at > seen.time[1]) & (at < seen.time[-2])
        slope = sign * spline(at[inside], 1)
        J = np.stack([slope, slope * when[inside, None]], -1)
        parts.append((rate[inside] - spline(at[inside]), J, spline(at[inside], 2), when[inside]))
    residual, J, curvature, when = (np.concatenate(p) for p in zip(*parts, strict=True))
    size = np.linalg.norm(residual, axis=1)
    usual = float(np.sqrt(np.mean(size**2))) if a.events else 1.4826 * float(np.median(size))
    scale = max(usual, 1e-9)
    weight = 1.0 / (1.0 + (size / (2.0 * scale)) ** 2) ** 2
    variance = 0.5 * scale**2
    prior = np.diag([0.0, variance / (1e-6 * DRIFT_PRIOR_PPM) ** 2])
    H = np.einsum("n,nki,nkj->ij", weight, J, J) + prior
    powers = np.stack([np.ones_like(when), when], -1)
    bent = np.einsum("n,nk,nk,ni,nj->ij", weight, curvature, residual, powers, powers)
    gradient = np.einsum("n,nki,nk->ni", weight, J, residual)
    return _Linearised(H, H - bent, gradient, when, prior, variance)


def _sandwich(model: _Linearised) -> Float[Array, "2 2"]:
    """Covariance of an M-estimate whose errors are correlated within blocks.

    Few blocks often agree by chance: the errors are at least those of the samples, `_ALIKE` of
    which are as one.
    """
    block = np.floor((model.when - model.when.min()) / _BLOCK_S).astype(int)
    sums = np.zeros((block.max() + 1, 2))
    np.add.at(sums, block, model.gradient)
    count = np.unique(block).size
    of_blocks = sums.T @ sums * count / max(count - 2, 1)
    of_samples = _ALIKE * model.gradient.T @ model.gradient
    inverse = np.linalg.inv(model.curved)
    return max((inverse @ (meat + model.variance * model.prior) @ inverse
                for meat in (of_blocks, of_samples)), key=lambda cov: cov[0, 0])  # fmt: skip


def _on_grid(signal: ViewSignal, step: float) -> Float[Array, "n K"]:
    """Samples at even times, with outliers compressed."""
    grid = np.arange(signal.time[0], signal.time[-1], step)
    soft = signal.rate
    if not signal.events:
        size = np.linalg.norm(signal.rate, axis=1, keepdims=True)
        usual = 3.0 * float(np.median(size)) + 1e-9
        soft = signal.rate / np.sqrt(1.0 + (size / usual) ** 2)
    values = interpolate(grid, signal.time, soft)
    return values - values.mean(0)


def _smoothed(signal: ViewSignal) -> ViewSignal:
    from scipy.ndimage import gaussian_filter1d, median_filter

    rate = signal.rate
    if not signal.events:
        median = median_filter(rate, size=(5, 1), mode="nearest")
        off = np.linalg.norm(rate - median, axis=1)
        spike = off > 8.0 * 1.4826 * np.median(off) + 1e-9
        rate = np.where(spike[:, None], median, rate)
    smooth = gaussian_filter1d(rate, _SMOOTH, axis=0, mode="nearest")
    return replace(signal, rate=smooth)


def _duration(signal: ViewSignal) -> float:
    return float(np.ptp(signal.time)) if len(signal.time) > 20 else 0.0


def _activity(signal: ViewSignal) -> float:
    """Robust magnitude of the rates: their 75th percentile [rad/s]."""
    return float(np.quantile(np.linalg.norm(signal.rate, axis=1), 0.75))


def _peak(signal: ViewSignal) -> float:
    """Largest sample against the usual ones."""
    size = np.linalg.norm(signal.rate, axis=1)
    return float(size.max() / (1.4826 * np.median(size) + 1e-6))
