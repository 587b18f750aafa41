"""Ways that a walk follows, given by their points: straight ones, and any others."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.walk import WALK_RATIO
from egocap_sim.motion.kinematics.curves import minimum_jerk

BEFORE_S, AFTER_S = 4.0, 6.0  # a course is known this long before and after the walk


class Course:
    """Position, heading and gait over time, as `walk.walk_along` takes them."""

    def __init__(
        self,
        times: Float[Array, "N"],
        xy: Float[Array, "N 2"],
        heading: Float[Array, "N"],
        gait: Float[Array, "N"],
        speed: float,
        starts: float,
        ends: float,
    ) -> None:
        self.starts, self.ends, self.step_s = starts, ends, float(np.sqrt(WALK_RATIO / speed))
        self._t, self._xy, self._heading, self._gait = times, xy, heading, gait

    def at(self, t: Array) -> tuple[Array, Array]:
        """Positions (T, 2) and headings (T,) at times."""
        xy = np.stack([np.interp(t, self._t, self._xy[:, a]) for a in (0, 1)], -1)
        return xy, np.interp(t, self._t, self._heading)

    def amplitude(self, t: Array | float) -> Array:
        """How much of a full gait there is, 0 standing to 1."""
        return np.asarray(np.interp(t, self._t, self._gait))


def course_times(seconds: float, fps: float = 60.0) -> Float[Array, "N"]:
    """The times at which a course of that length is given."""
    return np.arange(-round(BEFORE_S * fps), round((seconds + AFTER_S) * fps) + 1) / fps


def straight(length_m: float, speed: float) -> tuple[Course, float]:
    """From standing at the origin along x to standing `length_m` further, and its seconds."""
    step_s = float(np.sqrt(WALK_RATIO / speed))
    starts, ramp = 0.3, 2.0 * step_s
    ends = starts + max(length_m / speed, ramp)
    seconds = ends + 3.3 * step_s
    t = course_times(seconds)
    up = minimum_jerk((t - starts) / ramp)
    down = 1.0 - minimum_jerk((t - ends + 0.3 * step_s) / ramp)
    gait = up * down
    x = np.concatenate([[0.0], np.cumsum(gait[:-1] * np.diff(t))]) * speed
    xy = np.stack([x * length_m / x[-1], np.zeros(len(t))], -1)
    return Course(t, xy, np.zeros(len(t)), gait, speed, starts, ends), seconds
