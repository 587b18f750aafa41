"""Sound of a scene, as its cameras' microphones record it: steps, voice and noise of the room.

Made for the synchronisation of camera files; not a model of acoustics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from egocap.data.sequence import Sequence
from egocap_sim.core.rng import make_rng

RATE = 48_000
_STEP_S, _SYLLABLE_S, _ECHO_S = 0.03, 0.12, 0.15
_SYLLABLES_HZ = 1.5
_STEP, _VOICE, _ROOM, _OWN = 0.4, 0.15, 0.004, 0.004  # amplitudes


@dataclass(frozen=True, eq=False)
class SceneSound:
    """The sound of a scene from `start` on [s]."""

    start: float
    samples: Float32[Array, "N"]

    def recorded(
        self, times: Float[Array, "M"], gain: float, rng: np.random.Generator
    ) -> Float32[Array, "M"]:
        """What a microphone of a gain records at times of the scene, with its own noise."""
        heard = np.interp((times - self.start) * RATE, np.arange(len(self.samples)), self.samples)
        noisy = gain * heard + rng.normal(0.0, _OWN, len(times))
        return np.clip(noisy, -1.0, 1.0).astype(np.float32)


def scene_sound(sequence: Sequence) -> SceneSound:
    """Sound of a sequence and of a second before and after it; the same for the same seed."""
    rng = make_rng(sequence.manifest.seed, "sound")
    start, end = float(sequence.times[0]) - 1.0, float(sequence.times[-1]) + 1.0
    samples = rng.normal(0.0, _ROOM, int((end - start) * RATE))
    contact = sequence.truth.contact
    steps = sequence.times[1:][(contact[1:] & ~contact[:-1]).any(1)]
    spoken = rng.uniform(start, end, rng.poisson(_SYLLABLES_HZ * (end - start)))
    for times, length, loud in ((steps, _STEP_S, _STEP), (spoken, _SYLLABLE_S, _VOICE)):
        for time in times:
            _add_burst(samples, time - start, length, loud * rng.uniform(0.3, 1.0), rng)
    return SceneSound(start, samples.astype(np.float32))


def _add_burst(
    samples: Float[Array, "N"], at: float, length: float, loud: float, rng: np.random.Generator
) -> None:
    """Noise that begins suddenly, lasts for a length [s] and fades away."""
    first = int(at * RATE)
    count = min(int((length + _ECHO_S) * RATE), len(samples) - first)
    if first < 0 or count <= 0:
        return
    since = np.arange(count) / RATE
    fade = np.exp(-np.maximum(since - length, 0.0) / (0.3 * _ECHO_S))
    samples[first : first + count] += loud * fade * rng.normal(0.0, 0.4, count)
