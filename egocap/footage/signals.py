"""What one view saw and heard over its own clock, as rates of change: rotation, light, sound."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.media.sound import Soundtrack

_SOUND_SMOOTH = 1.0  # standard deviation of the smoothing of sound's power, samples
_LOUD = 2.0  # times the usual amplitude: where sound counts


@dataclass(frozen=True, eq=False)
class ViewSignal:
    """What one view saw over its own clock; every sample is a mean rate between two pictures."""

    time: Float[Array, "N"]  # s, own clock, middle of the interval
    rate: Float[Array, "N K"]
    events: bool = False  # whether single large samples are the signal, not errors


def rotation_signal(
    time: Float[Array, "N"], turn: Float[Array, "N 3"], fresh: Bool[Array, "N"]
) -> ViewSignal:
    """Angular rates from the rotations since the picture before [rad].

    Pictures that are not `fresh` (damaged, or repeating the one before) are merged with the next;
    intervals longer than three periods are left out.
    """
    places = np.flatnonzero(fresh)
    known = np.asarray(np.isfinite(turn).all(1))
    total = np.cumsum(np.where(known[:, None], turn, 0.0), 0)[places]
    return _rates(time[places], total, np.cumsum(~known)[places])


def light_signal(
    time: Float[Array, "N"], light: Float[Array, "N"], fresh: Bool[Array, "N"]
) -> ViewSignal:
    """Rate of change of the logarithm of the mean grey level, less its running median."""
    from scipy.ndimage import median_filter

    places = np.flatnonzero(fresh)
    level = np.log(np.maximum(light[places], 1.0))
    slow = median_filter(level, size=2 * max(1, len(level) // 40) + 31, mode="nearest")
    found = _rates(time[places], (level - slow)[:, None], np.zeros(len(places)))
    return replace(found, events=True)


def sound_signal(time: Float[Array, "N"], amplitude: Float[Array, "N"]) -> ViewSignal:
    """Rate of change of the logarithm of the amplitude, above the usual noise."""
    from scipy.ndimage import gaussian_filter1d

    amplitude = np.sqrt(gaussian_filter1d(amplitude**2, _SOUND_SMOOTH, mode="nearest"))
    usual, loud = np.quantile(amplitude, [0.5, 0.995])  # free of the microphone's gain
    level = np.log1p(amplitude / max(_LOUD * usual, loud / _LOUD, 1e-9))
    return replace(_rates(time, level[:, None], np.zeros(len(time))), events=True)


def _rates(
    time: Float[Array, "n"], total: Float[Array, "n K"], unknown: Float[Array, "n"]
) -> ViewSignal:
    """Differences over the steps in time, where nothing in between is unknown."""
    if len(time) < 2:
        return ViewSignal(np.zeros(0), np.zeros((0, total.shape[1])))
    step = np.diff(time)
    good = (step > 0) & (step < 3.5 * np.median(step)) & (np.diff(unknown) == 0)
    rate = np.diff(total, axis=0)[good] / step[good, None]
    return ViewSignal(0.5 * (time[1:] + time[:-1])[good], rate)


@dataclass(frozen=True, eq=False)
class ViewSignals:
    """All that one view shows of its clock."""

    rotation: ViewSignal
    light: ViewSignal
    sound: ViewSignal | None = None
    waveform: Soundtrack | None = None  # of the sound
