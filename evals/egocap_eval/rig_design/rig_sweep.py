"""Sweeps of a stereo rig's measures, and the rigs that they span."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import parse_rig
from egocap.errors import InputError

DEFAULTS: dict[str, float] = {
    "baseline": 0.35, "forward": 0.37, "up": 0.14, "pitch": 90.0, "toe_out": 0.0, "fov": 180.0,
}  # fmt: skip
"""EgoRig1: metres and degrees, as in rig files; `fov` spans the width of the image."""
SIZE = (640, 512)
MOST_CANDIDATES = 2000


@dataclass(frozen=True)
class Sweep:
    """Values of one measure of a rig."""

    name: str
    values: tuple[float, ...]


def parse_sweep(text: str) -> Sweep:
    """Read 'baseline=0.05:0.60:12' (from, to, how many) or 'up=0.1'. Raises InputError."""
    form = f"NAME=LOW:HIGH:COUNT or NAME=VALUE, NAME one of {', '.join(DEFAULTS)}"
    name, equals, rest = text.partition("=")
    if name not in DEFAULTS or not equals:
        raise InputError(f"a sweep '{text}'", valid=form)
    try:
        numbers = [float(part) for part in rest.split(":")]
    except ValueError:
        raise InputError(f"not a number in the sweep '{text}'", valid=form) from None
    if not np.isfinite(numbers).all():
        raise InputError(f"not a finite number in the sweep '{text}'", valid=form)
    if len(numbers) == 1:
        return Sweep(name, (numbers[0],))
    if len(numbers) != 3:
        raise InputError(f"the sweep '{text}' is not a range", valid=form)
    low, high, count = numbers
    if not low < high or count != int(count) or not 2 <= count <= MOST_CANDIDATES:
        raise InputError(f"the sweep '{text}' is not a range",
                         valid="LOW below HIGH, COUNT a whole number from 2")  # fmt: skip
    return Sweep(name, tuple(round(float(v), 6) for v in np.linspace(low, high, int(count))))


def grid(sweeps: Sequence[Sweep]) -> list[dict[str, float]]:
    """Measures of every rig that the sweeps span, the defaults for the rest. Raises InputError."""
    names = [s.name for s in sweeps]
    if not sweeps or len(set(names)) != len(names):
        raise InputError(f"sweeps of {', '.join(names) or 'nothing'}", valid="each measure once")
    count = int(np.prod([len(s.values) for s in sweeps]))
    if count > MOST_CANDIDATES:
        raise InputError(f"{count} rigs", valid=f"at most {MOST_CANDIDATES}")
    combinations = product(*(s.values for s in sweeps))
    return [DEFAULTS | dict(zip(names, values, strict=True)) for values in combinations]


def make_rig(measures: Mapping[str, float]) -> Rig:
    """A stereo rig of two equidistant cameras. Raises FileError for impossible measures."""
    stereo = {n: measures[n] for n in ("baseline", "forward", "up", "pitch", "toe_out")}
    lens = {"model": "equidistant", "width": SIZE[0], "height": SIZE[1], "fov": measures["fov"]}
    return parse_rig({"name": "candidate", "lens": lens, "stereo": stereo}, "sweep")
