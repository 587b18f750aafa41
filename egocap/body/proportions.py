"""Proportions of a person on the tracker's skeleton, and their file body.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field

from egocap.body.labels import LABELS, other_side, without_side
from egocap.body.skeleton import (
    LABEL_POINTS,
    POINT_COUNT,
    POINT_INDEX,
    POINT_PARENTS,
    POINTS,
    rest_points,
)
from egocap.errors import FileError, InputError
from egocap.files import write_json
from egocap.schema import Number, Strict, checked, read_json, refuse_newer

SCHEMA = 1

LIMB_BONES: tuple[str, ...] = tuple(
    side + end
    for side in ("left_", "right_")
    for end in ("elbow", "wrist", "hand", "knee", "ankle")
)
"""Points whose bone is vertical in the rest pose."""

_RANGES: dict[str, tuple[float, float]] = {
    "head": (0.0, 0.30), "neck": (0.0, 0.25), "upper_spine": (0.03, 0.25),
    "lower_spine": (0.05, 0.60), "clavicle": (0.0, 0.25), "shoulder": (0.05, 0.35),
    "elbow": (0.12, 0.50), "wrist": (0.10, 0.45), "hand": (0.02, 0.25), "hip": (0.03, 0.45),
    "knee": (0.20, 0.70), "ankle": (0.18, 0.65), "foot": (0.04, 0.30),
}  # fmt: skip
"""Valid length of the offset to each kind of point, metres."""


class _BodyFile(Strict):
    kind: Literal["egocap-body"]
    schema_version: int = Field(ge=1)
    units: Literal["m"]
    offsets: dict[str, tuple[Number, Number, Number]]


@dataclass(frozen=True, eq=False)
class Proportions:
    """Rest offset of each of `skeleton.POINTS` from the joint that carries it, head axes, metres.

    The rest pose stands upright with the arms hanging. Offsets of the trunk, the hips and the feet
    are general vectors. Raises InputError for a wrong shape or a length out of range.
    """

    offsets: Float[Array, "22 3"]

    def __post_init__(self) -> None:
        offsets = np.array(self.offsets, float)
        if offsets.shape != (POINT_COUNT, 3):
            raise InputError(f"proportions have shape {offsets.shape}", valid=f"({POINT_COUNT}, 3)")
        for name, length in zip(POINTS, np.linalg.norm(offsets, axis=1), strict=True):
            low, high = _RANGES[without_side(name)]
            if not low <= length <= high:
                raise InputError(
                    f"the bone to '{name}' is {length:.3f} m long",
                    valid=f"{low:.2f} to {high:.2f} m",
                )
        offsets.flags.writeable = False
        object.__setattr__(self, "offsets", offsets)

    def __repr__(self) -> str:
        m = self.bone_lengths
        arm, leg = m["left_elbow"] + m["left_wrist"], m["left_knee"] + m["left_ankle"]
        return f"Proportions(arm {arm:.2f} m, leg {leg:.2f} m, trunk {m['lower_spine']:.2f} m)"

    @property
    def bone_lengths(self) -> dict[str, float]:
        """Length in metres of the offset to each point."""
        lengths = np.linalg.norm(self.offsets, axis=1)
        return {name: float(length) for name, length in zip(POINTS, lengths, strict=True)}

    @property
    def rest_joints(self) -> Float[Array, "18 3"]:
        """The labelled points of the rest pose in the head frame, metres."""
        return self.rest_points[list(LABEL_POINTS)]

    @cached_property
    def rest_points(self) -> Float[Array, "22 3"]:
        """All `skeleton.POINTS` of the rest pose in the head frame, metres."""
        points = rest_points(self)
        points.flags.writeable = False
        return points

    @property
    def mirrored(self) -> Proportions:
        """The mirrored person: left and right are swapped."""
        mirror = [POINT_INDEX[other_side(name)] for name in POINTS]
        return Proportions(self.offsets[mirror] * [1.0, -1.0, 1.0])

    @classmethod
    def from_lengths(cls, height: float = 1.75, **lengths: float) -> Proportions:
        """An average person of a height in metres, with measured lengths of some bones.

        `lengths` are metres by the name of the point at the bone's far end, without the side:
        elbow (upper arm), wrist (forearm), hand (wrist to knuckles), knee (thigh), ankle (shank),
        foot (ankle to ball), shoulder (clavicle to shoulder), hip, lower_spine, upper_spine.

        Source: segment lengths of Drillis & Contini 1966 as printed in Winter, Biomechanics and
        Motor Control of Human Movement, fig. 4.1; joints inside the trunk by proportion.
        """
        if not 1.0 <= height <= 2.4:
            raise InputError(f"a height of {height} m", valid="1.0 to 2.4 m")
        left = {
            "clavicle": (0.015, 0.015, -0.03), "shoulder": (-0.015, 0.100, 0.008),
            "elbow": (0, 0, -0.186), "wrist": (0, 0, -0.146), "hand": (0, 0, -0.054),
            "hip": (0.0, 0.050, -0.110), "knee": (0, 0, -0.245), "ankle": (0, 0, -0.246),
            "foot": (0.075, 0, -0.030),
        }  # fmt: skip
        unit_offsets = {
            "head": (0.03, 0, 0.04), "neck": (0, 0, 0), "upper_spine": (-0.012, 0, -0.062),
            "lower_spine": (0.0, 0, -0.180),
        }  # fmt: skip
        unknown = set(lengths) - set(left) - set(unit_offsets)
        if unknown:
            names = ", ".join(sorted(unknown))
            raise InputError(f"no bone '{names}'", valid=[*unit_offsets, *left])
        rows = []
        for name in POINTS:
            side = -1.0 if name.startswith("right_") else 1.0
            kind = without_side(name)
            offset = np.array((unit_offsets | left)[kind]) * (height, side * height, height)
            if kind in lengths:
                offset *= lengths[kind] / np.linalg.norm(offset)
            rows.append(offset)
        return cls(np.array(rows))

    @classmethod
    def from_rest_joints(cls, joints: Mapping[str, Float[Array, "3"]]) -> Proportions:
        """A person from positions of all `POINTS`, standing upright and facing +x.

        Positions are in the head frame, metres. Arms and legs may be bent: only their lengths are
        used. Trunk, hips and feet are kept as given. Raises InputError for missing or unknown
        points.
        """
        if set(joints) != set(POINTS):
            wrong = sorted(set(joints) ^ set(POINTS))
            raise InputError(f"missing or unknown rest joints: {', '.join(wrong)}", valid=POINTS)
        where = np.array([np.asarray(joints[name], float) for name in POINTS])
        offsets = np.array(
            [where[i] - (where[parent] if parent >= 0 else 0.0)
             for i, parent in enumerate(POINT_PARENTS)]
        )  # fmt: skip
        for name in LIMB_BONES:
            i = POINT_INDEX[name]
            offsets[i] = (0.0, 0.0, -np.linalg.norm(offsets[i]))
        return cls(offsets)

    def to_dict(self) -> dict[str, object]:
        """Content of body.json."""
        return {
            "kind": "egocap-body",
            "schema_version": SCHEMA,
            "units": "m",
            "offsets": {name: row.tolist() for name, row in zip(POINTS, self.offsets, strict=True)},
        }

    def save(self, path: str | Path) -> None:
        """Write body.json. Raises as `egocap.files.disk_errors`."""
        write_json(Path(path), self.to_dict())

    @classmethod
    def load(cls, path: str | Path) -> Proportions:
        """Read body.json. FileError names the missing, unknown or invalid key."""
        path = Path(path)
        data = read_json(path)
        refuse_newer(data, SCHEMA, path)
        offsets = checked(_BodyFile, data, path).offsets
        for name in POINTS:
            if name not in offsets:
                raise FileError(path, "missing", key=f"offsets.{name}")
        for name in offsets:
            if name not in POINT_INDEX:
                raise FileError(path, "unknown key", key=f"offsets.{name}", valid=POINTS)
        try:
            return cls(np.array([offsets[name] for name in POINTS]))
        except InputError as error:
            raise FileError(path, str(error), key="offsets") from None


assert len(LABEL_POINTS) == len(LABELS)
