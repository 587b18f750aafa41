"""The volumetric body: 91 isotropic Gaussians attached to the tracker's skeleton.

A limb is a row of Gaussians along its bone, the trunk six rows of three, sized by a person's
proportions and average girths. Each has a peak density per metre of ray and a colour. The sum of
all densities is a smooth occupancy of space: a ray through the axis of a limb is absorbed, a ray at
the limb's radius is half absorbed.

Source: EgoCap 2016, section 4.1; Rhodin et al. 2015, "A versatile scene model with differentiable
visibility applied to generative pose estimation". Girths: rounded from the ANSUR II survey of
adults (Gordon et al. 2014), as shares of the stature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from pydantic import Field

from egocap.body.proportions import Proportions
from egocap.body.skeleton import JOINTS, POINT_INDEX, POINTS
from egocap.errors import FileError, InputError
from egocap.files import write_json
from egocap.schema import Number, Strict, checked, read_json, refuse_newer

SCHEMA = 1
SKULL = -1
"""Carrier of the Gaussians of the head: the head frame itself."""

RADIUS_SIGMAS = 1.8
"""Radius of the outline, where the transmittance is one half, in standard deviations."""
CORE_DEPTH = float(np.log(2.0) * np.exp(RADIUS_SIGMAS**2 / 2.0))
"""Optical depth through the axis of a limb with transmittance one half at its radius: 3.5."""

_STATURE_SHARES = {"upper_spine": 0.062, "lower_spine": 0.18, "hip": 0.11, "knee": 0.245,
                   "ankle": 0.246}  # fmt: skip
"""Heights of the segments between neck and ankle, as in `Proportions.from_lengths`."""


@dataclass(frozen=True)
class _Limb:
    """A row of Gaussians along the bone from a joint to a point, radii as shares of the stature."""

    joint: str
    tip: str
    places: tuple[float, ...]  # 0 at the joint, 1 at the tip, possibly beyond
    radii: tuple[float, ...]


_LIMBS: dict[str, _Limb] = {
    "shoulder": _Limb("clavicle", "shoulder", (0.45, 0.97), (0.033, 0.034)),
    "upper_arm": _Limb(
        "shoulder", "elbow", (0.10, 0.30, 0.50, 0.70, 0.92), (0.033, 0.031, 0.030, 0.028, 0.027)
    ),
    "forearm": _Limb(
        "elbow", "wrist", (0.10, 0.30, 0.52, 0.74, 0.95), (0.027, 0.027, 0.025, 0.021, 0.018)
    ),
    "hand": _Limb("wrist", "hand", (0.25, 0.70, 1.10, 1.50), (0.018, 0.020, 0.018, 0.014)),
    "thigh": _Limb(
        "hip", "knee", (0.04, 0.19, 0.34, 0.49, 0.64, 0.80, 0.96),
        (0.052, 0.052, 0.049, 0.046, 0.042, 0.038, 0.036),
    ),
    "shank": _Limb(
        "knee", "ankle", (0.10, 0.27, 0.44, 0.61, 0.78, 0.95),
        (0.034, 0.034, 0.033, 0.029, 0.024, 0.023),
    ),
    "foot": _Limb("ankle", "foot", (0.0, 0.5, 1.0, 1.4), (0.025, 0.023, 0.022, 0.018)),
}  # fmt: skip
"""Limbs of either side."""

_TRUNK: tuple[tuple[str, float, float, float], ...] = (
    ("upper_spine", 0.06, 0.085, 0.058),
    ("upper_spine", 0.26, 0.092, 0.067),
    ("upper_spine", 0.46, 0.090, 0.066),
    ("lower_spine", 0.68, 0.086, 0.062),
    ("lower_spine", 0.87, 0.092, 0.064),
    ("lower_spine", 1.05, 0.096, 0.067),
)
"""Rows of three: carrier, height from mid-shoulder (0) to mid-hip (1), half breadth and depth."""

_NECK = ((0.25, 0.036), (0.95, 0.038))
"""Place between neck and upper spine, radius."""
_HEAD = (
    (0.035, 0.012, 0.036), (0.040, 0.050, 0.040), (0.010, 0.040, 0.044), (0.000, 0.080, 0.046),
    (0.025, 0.088, 0.042),
)  # fmt: skip
"""Forward and up of the skull base, radius."""


@dataclass(frozen=True, eq=False)
class GaussianBody:
    """91 Gaussians on a skeleton. Offsets are in the carrying joint's rest frame (head axes).

    Raises InputError for wrong shapes or values out of range.
    """

    proportions: Proportions
    parts: tuple[str, ...]  # name of the part each Gaussian belongs to, e.g. 'left_forearm'
    joint: Int[Array, "91"]  # index into `skeleton.JOINTS`; -1: the skull
    offset: Float[Array, "91 3"]  # metres
    sigma: Float[Array, "91"]  # metres
    density: Float[Array, "91"]  # at the centre, per metre
    colour: Float[Array, "91 3"]  # hue, saturation, value in [0, 1]

    def __post_init__(self) -> None:
        G = len(self.parts)
        shapes = {"joint": (G,), "offset": (G, 3), "sigma": (G,), "density": (G,), "colour": (G, 3)}
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), int if name == "joint" else float)
            if values.shape != shape or not np.isfinite(values).all():
                raise InputError(f"{name} of the Gaussians has shape {values.shape}",
                                 valid=f"{shape}, finite")  # fmt: skip
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if not (self.sigma.min() >= 1e-3 and self.sigma.max() <= 0.5):
            raise InputError("a Gaussian's sigma is out of range", valid="0.001 to 0.5 m")
        if not (self.density.min() >= 0.0 and self.density.max() <= 1e4):
            raise InputError("a Gaussian's density is out of range", valid="0 to 10000 per metre")
        if self.joint.min() < SKULL or self.joint.max() >= len(JOINTS):
            raise InputError("a Gaussian's joint is out of range", valid=f"-1 to {len(JOINTS) - 1}")
        if self.colour.min() < 0.0 or self.colour.max() > 1.0:
            raise InputError("a colour is out of range", valid="hue, saturation, value from 0 to 1")

    @classmethod
    def from_proportions(cls, proportions: Proportions, girth: float = 0.98) -> GaussianBody:
        """Grey Gaussians of a person of average build.

        `girth` scales every radius; the default fits the simulator's clothed people best.
        """
        if not 0.5 <= girth <= 2.0:
            raise InputError(f"a girth of {girth}", valid="0.5 to 2")
        scale = stature(proportions)
        rows = [*_head_rows(scale), *_trunk_rows(proportions, scale), *_limb_rows(proportions)]
        parts = tuple(part for part, *_ in rows)
        joint = np.array([_JOINT_INDEX[carrier] for _, carrier, *_ in rows])
        offset = np.array([where for *_, where, _ in rows])
        sigma = girth * scale * np.array([radius for *_, radius in rows]) / RADIUS_SIGMAS
        density = CORE_DEPTH / (sigma * np.sqrt(2.0 * np.pi) * _overlap(parts, offset, sigma))
        grey = np.tile([0.0, 0.0, 0.5], (len(rows), 1))
        return cls(proportions, parts, joint, offset, sigma, density, grey)

    def with_colour(self, colour: Float[Array, "91 3"]) -> GaussianBody:
        """The same body with other colours (hue, saturation, value)."""
        return replace(self, colour=colour)

    def save(self, path: str | Path) -> None:
        """Write gaussians.json with exact numbers. Raises as `egocap.files.disk_errors`."""
        entries = [
            {
                "part": part, "joint": "skull" if joint == SKULL else JOINTS[joint].name,
                "offset": offset.tolist(), "sigma": float(sigma), "density": float(density),
                "hsv": colour.tolist(),
            }
            for part, joint, offset, sigma, density, colour in zip(
                self.parts, self.joint, self.offset, self.sigma, self.density, self.colour,
                strict=True,
            )
        ]  # fmt: skip
        data = {
            "kind": "egocap-gaussians", "schema_version": SCHEMA, "units": "m",
            "body": self.proportions.to_dict()["offsets"], "gaussians": entries,
        }  # fmt: skip
        write_json(Path(path), data)

    @classmethod
    def load(cls, path: str | Path) -> GaussianBody:
        """Read gaussians.json. FileError names the missing, unknown or invalid key."""
        path = Path(path)
        data = read_json(path)
        refuse_newer(data, SCHEMA, path)
        file = checked(_GaussiansFile, data, path)
        if set(file.body) != set(POINTS):
            wrong = sorted(set(file.body) ^ set(POINTS))
            raise FileError(path, f"missing or unknown points: {', '.join(wrong)}", key="body")
        for i, entry in enumerate(file.gaussians):
            if entry.joint not in _JOINT_INDEX:
                raise FileError(path, f"no joint '{entry.joint}'", key=f"gaussians.{i}.joint",
                                valid=_JOINT_INDEX)  # fmt: skip
        entries = file.gaussians
        try:
            return cls(
                Proportions(np.array([file.body[name] for name in POINTS])),
                tuple(e.part for e in entries),
                np.array([_JOINT_INDEX[e.joint] for e in entries]),
                np.array([e.offset for e in entries]),
                np.array([e.sigma for e in entries]),
                np.array([e.density for e in entries]),
                np.array([e.hsv for e in entries]),
            )
        except InputError as error:
            raise FileError(path, str(error)) from None


def stature(proportions: Proportions) -> float:
    """Height in metres of an average person with these bones from neck to ankle."""
    segments = ("upper_spine", "lower_spine", "left_hip", "left_knee", "left_ankle")
    length = sum(abs(proportions.offsets[POINT_INDEX[point]][2]) for point in segments)
    return float(length / sum(_STATURE_SHARES.values()))


_JOINT_INDEX = {"skull": SKULL} | {joint.name: i for i, joint in enumerate(JOINTS)}
_Row = tuple[str, str, Array, float]  # part, carrier, offset (3,) m, radius as share of stature
_Vector = tuple[Number, Number, Number]


class _Entry(Strict):
    part: str
    joint: str
    offset: _Vector
    sigma: Number
    density: Number
    hsv: _Vector


class _GaussiansFile(Strict):
    kind: Literal["egocap-gaussians"]
    schema_version: int = Field(ge=1)
    units: Literal["m"]
    body: dict[str, _Vector]
    gaussians: Annotated[list[_Entry], Field(min_length=1, max_length=10_000)]


def _head_rows(scale: float) -> list[_Row]:
    return [("head", "skull", np.array([x, 0.0, z]) * scale, r) for x, z, r in _HEAD]


def _trunk_rows(proportions: Proportions, scale: float) -> list[_Row]:
    """Neck and trunk; trunk rows lie on the line from mid-shoulder to mid-hip."""
    rest = proportions.rest_points
    rows: list[_Row] = []
    for place, radius in _NECK:
        rows.append(("neck", "neck", place * proportions.offsets[POINT_INDEX["upper_spine"]],
                     radius))  # fmt: skip
    middle = [
        (rest[POINT_INDEX[f"left_{name}"]] + rest[POINT_INDEX[f"right_{name}"]]) / 2
        for name in ("shoulder", "hip")
    ]
    for carrier, place, breadth, depth in _TRUNK:
        centre = middle[0] + place * (middle[1] - middle[0]) - rest[POINT_INDEX[carrier]]
        part = "chest" if carrier == "upper_spine" else "pelvis"
        for side in (1.0, 0.0, -1.0):
            shift = np.array([0.0, side * (breadth - depth) * scale * 1.25, 0.0])
            rows.append((part, carrier, centre + shift, depth))
    return rows


def _limb_rows(proportions: Proportions) -> list[_Row]:
    rows: list[_Row] = []
    for side in ("left_", "right_"):
        for name, limb in _LIMBS.items():
            bone = proportions.offsets[POINT_INDEX[side + limb.tip]]
            for place, radius in zip(limb.places, limb.radii, strict=True):
                rows.append((side + name, side + limb.joint, place * bone, radius))
    return rows


def _overlap(
    parts: tuple[str, ...], offset: Float[Array, "G 3"], sigma: Float[Array, "G"]
) -> Float[Array, "G"]:
    """Summed weight of a part's Gaussians at each centre, by which its density is divided."""
    names = np.array(parts)
    same = names[:, None] == names[None]
    squared = np.sum((offset[:, None] - offset[None]) ** 2, axis=-1)
    return np.sum(same * np.exp(-0.5 * squared / sigma**2), axis=1)
