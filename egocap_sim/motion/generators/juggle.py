"""Three balls in a cascade: when each hand catches and throws, and the motion of doing so.

Source: C. Shannon, Scientific aspects of juggling (1981): (flight + dwell) x hands = (vacant +
dwell) x balls, for the timing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.stance import draw_style, standing
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import hermite, turn
from egocap_sim.motion.kinematics.posing import aim_wrists, pose_figure

BALLS = 3
PALM = 0.085  # metres from the wrist to the middle of the palm


@dataclass(frozen=True)
class JuggleParams:
    """A three-ball cascade."""

    flight: float = 0.62
    """Seconds a ball flies, 0.45 to 0.8; more is higher."""
    dwell: float = 0.30
    """Seconds a ball stays in a hand, 0.2 to 0.4."""


@dataclass(frozen=True)
class Cascade:
    """Timing: throw n is at `first + n * beat` seconds, with hand n % 2 (0 left), of ball n % 3."""

    first: float
    flight: float
    dwell: float

    @property
    def beat(self) -> float:
        """Seconds between throws: half a hand's period."""
        return (self.flight + self.dwell) / BALLS


def cascade(rng: np.random.Generator, params: JuggleParams) -> Cascade:
    """The timing a generator gives; the same that `juggle` begins with."""
    return Cascade(-float(rng.uniform(0.0, 1.0)), params.flight, params.dwell)


def juggle(
    t: Float[Array, "T"], rng: np.random.Generator, params: JuggleParams, fps: float
) -> Clip:
    """Juggle three balls, standing, for the times t [s]; the balls are under way throughout."""
    timing = cascade(rng, params)
    style = draw_style(rng)
    controls = standing(t, style, rng)
    ahead, height = rng.uniform(0.34, 0.40), rng.uniform(0.98, 1.06)
    wrist = np.stack([_palm(t, timing, hand, ahead, height) for hand in (0, 1)], 1)
    controls = aim_wrists(controls, wrist - [PALM, 0.0, 0.0])
    controls.pronation[:] = -1.35
    controls.wrist_bend[:] = -0.1
    controls.head_R = turn(pitch=-0.12) @ controls.head_R  # the eyes follow the tops of the flights
    return pose_figure("juggle", fps, controls)


def _palm(
    t: Float[Array, "T"], timing: Cascade, hand: int, ahead: float, height: float
) -> Float[Array, "T 3"]:
    """A scoop: caught outside and falling, thrown inside and rising, and back over the top."""
    side, period = 1.0 - 2.0 * hand, 2.0 * timing.beat
    caught = np.array([ahead, side * 0.27, height - 0.01])
    thrown = np.array([ahead, side * 0.12, height + 0.02])
    falling, rising = np.array([0.0, 0.0, -1.3]), np.array([0.0, 0.0, 2.1])
    since = (t - timing.first - hand * timing.beat) % period  # seconds after a throw
    vacant = period - timing.dwell
    back = hermite(since / vacant, thrown, caught, rising * vacant, falling * vacant)
    s = (since - vacant) / timing.dwell
    scoop = hermite(s, caught, thrown, falling * timing.dwell, rising * timing.dwell)
    return np.where((since < vacant)[:, None], back, scoop)
