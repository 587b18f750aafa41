"""Sample random head-worn rigs, for training detectors on many rigs.

All cameras of a rig have one lens design, with manufacturing and mounting tolerances. Families:
`arms`, two cameras on arms before a helmet or a headset (the default); `glasses`, two beside the
nose; `headset`, four on a headset, two of them sideways; `single`, one before the brow, on a cap's
brim or on a helmet's arm; `any` draws one of the last three. The ranges are those of published
rigs (EgoCap, EgoGlass, UnrealEgo, xR-EgoPose, SceneEgo, Meta Quest, Project Aria).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Affine, Camera
from egocap.cameras.rig import Mount, Rig, camera_rotation
from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid, unit
from egocap_sim.core.resources import SAMPLED

Family = Literal["arms", "glasses", "headset", "single", "any"]
SIZE = (1280, 1024)  # pixels
BROW_M = 0.12  # from the skull base forward to the brow
BASELINE_M = (0.06, 0.50)
FORWARD_M = (0.02, 0.30)  # before the brow
UP_M = (0.04, 0.18)  # above the skull base: from the eyes to above the brow
PITCH_DEG = (50.0, 100.0)
TOE_OUT_DEG = (-5.0, 20.0)
FOV_DEG = (140.0, 220.0)
FILL = (0.9, 1.2)  # diameter of the image circle, in image widths
ANY_FILL = (0.75, 1.45)  # of the families without arms: from a dark rim all around to a crop
MODELS = ("equidistant", "kannala_brandt", "ocam")
WIDE_FOV_DEG = (100.0, 220.0)  # of the families without arms
SIZES = ((640, 512), (640, 480), (512, 512), (400, 400), (848, 800), (1280, 1024), (256, 256))
ROLL_DEG = (0.0, 0.0, 0.0, 0.0, 90.0, 180.0, 270.0)  # some rigs hang their cameras upside down

_MOUNT_DEG, _MOUNT_M = 1.5, 0.003  # standard deviations of the mounting error
_BEND = (-0.07, 0.03)  # in r = theta + bend theta^3; equisolid: -1/24
_TRIES = 100
_HEADSET_M, _HELMET_M = 0.10, 0.05  # before the brow: cameras farther out are clear of it
_BRIM_M, _BRIM_UP_M = 0.09, 0.11  # the end of a cap's brim, and its height above the skull base


def sample_rig(rng: np.random.Generator, family: Family = "arms") -> Rig:
    """Sample a rig of a family; those on arms have the views 'left' and 'right'."""
    if family == "any":
        family = rng.choice(list(_ANY), p=list(_ANY.values()))
    return _FAMILIES[family](rng)


def headgear_for(rig: Rig, rng: np.random.Generator, family: Family = "arms") -> str:
    """Sample what carries a sampled rig, clear of its cameras: a value of `[person] headgear`."""
    forward = rig.T_head_camera[:, 0, 3].min() - BROW_M
    if len(rig.mounts) == 4:
        return "headset"
    if len(rig.mounts) == 1:
        under_brim = rig.mounts[0].T_head_camera[2, 3] < _BRIM_UP_M
        choices = ["helmet"]
        if forward > _HEADSET_M:
            choices.append("headset")
        if forward > _BRIM_M and under_brim:
            choices.append("cap")
        return str(rng.choice(choices))
    if family in ("glasses", "any"):
        return "glasses"
    choices = ["none"]
    if forward > _HELMET_M:
        choices.append("helmet")
    if forward > _HEADSET_M:
        choices.append("headset")
    return str(rng.choice(choices))


def _arms(rng: np.random.Generator) -> Rig:
    baseline, forward = rng.uniform(*BASELINE_M), BROW_M + rng.uniform(*FORWARD_M)
    up, pitch = rng.uniform(*UP_M), rng.uniform(*PITCH_DEG)
    toe_out, fov = rng.uniform(*TOE_OUT_DEG), rng.uniform(*FOV_DEG)
    lens = _Lens(rng, fov)
    mounts = [
        _mount(rng, name, lens, (forward, side * baseline / 2, up), (pitch, side * toe_out))
        for name, side in _SIDES
    ]
    return Rig(SAMPLED, tuple(mounts))


def _glasses(rng: np.random.Generator) -> Rig:
    """Two lenses in or just before the frame, looking down or ahead past nose and cheeks."""
    lens = _Lens(rng, rng.uniform(*WIDE_FOV_DEG), _size(rng), ANY_FILL)
    place = np.array([rng.uniform(0.125, 0.165), rng.uniform(0.03, 0.08), rng.uniform(0.0, 0.07)])
    pitch, toe_out, roll = _pitch(rng, lens), rng.uniform(-5.0, 25.0), rng.choice(ROLL_DEG)
    mounts = [
        _mount(rng, name, lens, place * (1.0, side, 1.0), (pitch, side * toe_out, side * roll))
        for name, side in _SIDES
    ]
    return Rig(SAMPLED, tuple(mounts))


def _headset(rng: np.random.Generator) -> Rig:
    """Four cameras at the edges of a headset: two look down ahead, two down to the sides."""
    lens = _Lens(rng, rng.uniform(120.0, 190.0), _size(rng), ANY_FILL)
    front = np.array([rng.uniform(0.20, 0.23), rng.uniform(0.04, 0.09), rng.uniform(-0.03, 0.07)])
    side_ = np.array([rng.uniform(0.16, 0.21), rng.uniform(0.10, 0.12), rng.uniform(-0.02, 0.07)])
    pitch, toe_out, roll = rng.uniform(35.0, 85.0), rng.uniform(0.0, 25.0), rng.choice(ROLL_DEG)
    below, aside = rng.uniform(25.0, 70.0), rng.uniform(40.0, 90.0)
    mounts = []
    for name, s in _SIDES:
        angles = (pitch, s * toe_out, s * roll)
        mounts.append(_mount(rng, f"front_{name}", lens, front * (1.0, s, 1.0), angles))
    for name, s in _SIDES:
        angles = (below, s * aside, s * roll)
        mounts.append(_mount(rng, f"side_{name}", lens, side_ * (1.0, s, 1.0), angles))
    return Rig(SAMPLED, tuple(mounts))


def _single(rng: np.random.Generator) -> Rig:
    """One camera near the middle plane: before the brow, at a cap's brim, or on a helmet's arm."""
    lens = _Lens(rng, rng.uniform(140.0, 220.0), _size(rng), ANY_FILL)
    forward = rng.uniform(0.25, 0.45) if rng.random() < 0.5 else rng.uniform(0.175, 0.25)
    place = np.array([forward, rng.normal(0.0, 0.02), rng.uniform(0.05, 0.16)])
    angles = (rng.uniform(55.0, 110.0), rng.normal(0.0, 6.0), rng.choice(ROLL_DEG))
    return Rig(SAMPLED, (_mount(rng, "head", lens, place, angles),))


_SIDES = (("left", 1.0), ("right", -1.0))
_FAMILIES: dict[str, Callable[[np.random.Generator], Rig]] = {
    "arms": _arms, "glasses": _glasses, "headset": _headset, "single": _single,
}  # fmt: skip
_ANY = {"glasses": 0.5, "headset": 0.2, "single": 0.3}  # probabilities for 'any'


def _size(rng: np.random.Generator) -> tuple[int, int]:
    return SIZES[int(rng.integers(len(SIZES)))]


def _pitch(rng: np.random.Generator, lens: _Lens) -> float:
    """Degrees below forward at which the lens sees down to the feet of a standing person."""
    return rng.uniform(max(25.0, 95.0 - np.rad2deg(lens.max_angle)), 95.0)


def _mount(
    rng: np.random.Generator,
    name: str,
    lens: _Lens,
    place: Iterable[float],
    angles: tuple[float, ...],
) -> Mount:
    """A camera at a place [m] and pitch, yaw and roll [deg], with mounting tolerances."""
    tilt = axis_angle(unit(rng.normal(size=3)), np.deg2rad(rng.normal(0, _MOUNT_DEG)))
    at = np.array([*place]) + rng.normal(0, _MOUNT_M, 3)
    return Mount(name, lens.sample_camera(rng), rigid(camera_rotation(*angles) @ tilt, at))


class _Lens:
    """A lens design; its cameras differ by manufacturing tolerances."""

    def __init__(
        self,
        rng: np.random.Generator,
        fov_deg: float,
        size: tuple[int, int] = SIZE,
        fill: tuple[float, float] = FILL,
    ) -> None:
        self.size = size
        self.model = str(rng.choice(MODELS))
        self.max_angle = np.deg2rad(fov_deg) / 2
        self.circle = size[0] * rng.uniform(*fill) / 2
        for _ in range(_TRIES):
            self.bend = (rng.uniform(*_BEND), rng.normal(0, 0.002))
            if self._valid():
                return
        raise AssertionError(f"no monotonic lens of {fov_deg} degrees found")

    def sample_camera(self, rng: np.random.Generator) -> Camera:
        """Sample a camera with this lens."""
        width, height = self.size
        centre = (np.array(self.size) - 1) / 2 + rng.normal(0, 0.01 * width, 2)
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
