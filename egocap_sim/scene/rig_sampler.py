"""Sample random stereo rigs, for training detectors on many rigs.

A rig has two cameras of one lens design on a headset, glasses or helmet arms, with manufacturing
and mounting tolerances. The ranges are those of published rigs.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Affine, Camera
from egocap.cameras.rig import Mount, Rig
from egocap.cameras.rig_files import camera_rotation
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid, unit
from egocap_sim.core.resources import SAMPLED

SIZE = (1280, 1024)  # pixels
BROW_M = 0.12  # from the skull base forward to the brow
BASELINE_M = (0.06, 0.50)
FORWARD_M = (0.02, 0.30)  # before the brow
UP_M = (0.04, 0.18)  # above the skull base: from the eyes to above the brow
PITCH_DEG = (50.0, 100.0)
TOE_OUT_DEG = (-5.0, 20.0)
FOV_DEG = (140.0, 220.0)
FILL = (0.9, 1.2)  # diameter of the image circle, in image widths
MODELS = ("equidistant", "kannala_brandt", "ocam")

_MOUNT_DEG, _MOUNT_M = 1.5, 0.003  # standard deviations of the mounting error
_BEND = (-0.07, 0.03)  # in r = theta + bend theta^3; equisolid: -1/24
_TRIES = 100
_HEADSET_M, _HELMET_M = 0.10, 0.05  # before the brow: cameras farther out are clear of it


def sample_rig(rng: np.random.Generator) -> Rig:
    """Sample a rig of two cameras, 'left' and 'right'."""
    baseline, forward = rng.uniform(*BASELINE_M), BROW_M + rng.uniform(*FORWARD_M)
    up, pitch = rng.uniform(*UP_M), rng.uniform(*PITCH_DEG)
    toe_out, fov = rng.uniform(*TOE_OUT_DEG), rng.uniform(*FOV_DEG)
    lens = _Lens(rng, fov)
    mounts = []
    for name, side in (("left", 1.0), ("right", -1.0)):
        R = camera_rotation(pitch, side * toe_out)
        tilt = axis_angle(unit(rng.normal(size=3)), np.deg2rad(rng.normal(0, _MOUNT_DEG)))
        place = np.array([forward, side * baseline / 2, up]) + rng.normal(0, _MOUNT_M, 3)
        mounts.append(Mount(name, lens.sample_camera(rng), rigid(R @ tilt, place)))
    return Rig(SAMPLED, tuple(mounts))


def headgear_for(rig: Rig, rng: np.random.Generator) -> str:
    """Sample what the rig is mounted on, clear of its cameras: 'helmet', 'headset' or 'none'."""
    forward = rig.T_head_camera[:, 0, 3].min() - BROW_M
    choices = ["none"]
    if forward > _HELMET_M:
        choices.append("helmet")
    if forward > _HEADSET_M:
        choices.append("headset")
    return str(rng.choice(choices))


class _Lens:
    """A lens design; its cameras differ by manufacturing tolerances."""

    def __init__(self, rng: np.random.Generator, fov_deg: float) -> None:
        self.model = str(rng.choice(MODELS))
        self.max_angle = np.deg2rad(fov_deg) / 2
        self.circle = SIZE[0] * rng.uniform(*FILL) / 2
        for _ in range(_TRIES):
            self.bend = (rng.uniform(*_BEND), rng.normal(0, 0.002))
            if self._valid():
                return
        raise AssertionError(f"no monotonic lens of {fov_deg} degrees found")

    def sample_camera(self, rng: np.random.Generator) -> Camera:
        """Sample a camera with this lens."""
        width, height = SIZE
        centre = (np.array(SIZE) - 1) / 2 + rng.normal(0, 0.01 * width, 2)
        focal = self.circle / float(self._radius(self.max_angle)) * (1 + rng.normal(0, 0.005))
        aspect, shear = 1 + rng.normal(0, 0.001), rng.normal(0, 0.001)
        unit_affine = np.array([[aspect, shear], [0.0, 1.0]])
        parameters: tuple[float, ...] = ()
        if self.model == "kannala_brandt":
            parameters = (*map(float, self.bend), 0.0, 0.0)
        elif self.model == "ocam":
            parameters, focal = self._polynomial(focal), 1.0
        return Camera(
            self.model, width, height, (float(centre[0]), float(centre[1])),
            _affine(focal * unit_affine), parameters, self.max_angle,
        )  # fmt: skip

    def _radius(self, theta: Float[Array, "*n"] | float) -> Array:
        bend = (0.0, 0.0) if self.model == "equidistant" else self.bend
        return np.asarray(theta + bend[0] * theta**3 + bend[1] * theta**5)

    def _valid(self) -> bool:
        """Whether the radius grows with the angle up to the rim, and Camera accepts the lens."""
        theta = np.linspace(0, 1.05 * self.max_angle, 200)
        if np.diff(self._radius(theta)).min() < 0.3 * (theta[1] - theta[0]):
            return False
        try:
            self.sample_camera(np.random.default_rng(0))
        except InputError:
            return False
        return True

    def _polynomial(self, focal: float) -> tuple[float, ...]:
        """Fit OCam's f(rho), without the linear term as in OCamCalib, by least squares."""
        theta = np.linspace(0.01, self.max_angle, 200)
        rho = focal * self._radius(theta)
        powers = np.array([0, 2, 3, 4, 5, 6])
        scaled = (rho / rho[-1])[:, None] ** powers
        found = np.linalg.lstsq(scaled, -rho / np.tan(theta), rcond=None)[0] / rho[-1] ** powers
        polynomial = np.zeros(powers[-1] + 1)
        polynomial[powers] = found
        return tuple(map(float, polynomial))


def _affine(matrix: Float[Array, "2 2"]) -> Affine:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)
