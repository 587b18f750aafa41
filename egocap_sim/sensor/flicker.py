"""Lamps on the mains: their light swells twice a period, and a shutter cuts pieces out of it.

Source: the mean of cos(w t) over an exposure of s seconds around t is sinc(w s / 2) cos(w t), so
that exposures of whole half periods of the mains (1/100 s at 50 Hz) show no flicker.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.sensor.config import SensorTable
from egocap_sim.sensor.timing import row_time


def lamp_light(times: Float[Array, "*n"], sensor: SensorTable, phase: float) -> Float[Array, "*n"]:
    """Mean light, 1 being that of a steady lamp, over exposures whose middles are at `times` [s].

    Without flicker 1 everywhere. `phase` (radians) is that of the light at time zero.
    """
    twice = 2.0 * sensor.mains_hz
    seen = sensor.flicker * np.sinc(twice * sensor.shutter_s)  # numpy's sinc has the pi in it
    return 1.0 + seen * np.cos(2.0 * np.pi * twice * np.asarray(times, float) + phase)


def lamp_rows(middle: float, height: int, sensor: SensorTable, phase: float) -> Float[Array, "H"]:
    """The same for every row of a picture whose middle row is exposed at `middle` [s]."""
    rows = row_time(np.full(height, middle), np.arange(height), height, sensor.readout_s)
    return lamp_light(rows, sensor, phase)


def lamp_phase(rng: np.random.Generator) -> float:
    """When in its period the mains is at time zero, radians."""
    return float(rng.uniform(0.0, 2.0 * np.pi))
