"""Random sensor faults of each frame, drawn from the seed before rendering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.cameras.rig import Mount, Rig
from egocap.data.truth import BLACK
from egocap.geometry import axis_angle, unit
from egocap_sim.sensor.config import SensorTable

_WAVES = 5  # number of sines in the exposure drift
_PERIOD_S = (2.0, 20.0)


def exposure_drift(times: Float[Array, "T"], deviation: float, rng: np.random.Generator) -> Array:
    """A slow random curve (T,) of zero mean and this standard deviation over long times.

    It depends on time alone: a shorter sequence has the same start.
    """
    low, high = np.log(_PERIOD_S)
    period = np.exp(rng.uniform(low, high, _WAVES))
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    waves = np.sin(2 * np.pi * times[:, None] / period + phase)
    return deviation * np.sqrt(2.0 / _WAVES) * waves.sum(1)


def draw_sources(
    frames: int, rate: float, stand_in: str, rng: np.random.Generator
) -> Int[Array, "frames"]:
    """The source of each frame's image: its own index, an earlier one, or BLACK.

    The first frame is never dropped.
    """
    dropped = rng.random(frames) < rate
    dropped[0] = False
    own = np.arange(frames)
    if stand_in == "black":
        return np.where(dropped, BLACK, own)
    return np.maximum.accumulate(np.where(dropped, 0, own))


def miscalibrate(rig: Rig, sensor: SensorTable, rng: np.random.Generator) -> Rig:
    """The rig with calibration errors of exactly the sensor's amounts.

    Every camera is rotated about a random axis and moved in a random direction; its focal lengths
    are scaled up or down and its centre is moved.
    """
    mounts = []
    for mount in rig.mounts:
        axis, way = unit(rng.normal(size=3)), unit(rng.normal(size=3))
        shift, sign = unit(rng.normal(size=2)), rng.choice([-1.0, 1.0])
        T = mount.T_head_camera.copy()
        T[:3, :3] = T[:3, :3] @ axis_angle(axis, np.deg2rad(sensor.calibration_rotation_deg))
        T[:3, 3] += sensor.calibration_translation_m * way
        scale = 1.0 + sign * sensor.calibration_focal
        centre = np.array(mount.camera.centre) + sensor.calibration_centre_px * shift
        affine = np.array(mount.camera.affine) * scale
        camera = replace(
            mount.camera,
            centre=(float(centre[0]), float(centre[1])),
            affine=tuple(tuple(map(float, row)) for row in affine),  # pyright: ignore
        )
        mounts.append(Mount(mount.name, camera, T))
    return replace(rig, mounts=tuple(mounts))
