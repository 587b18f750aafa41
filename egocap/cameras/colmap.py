"""COLMAP's cameras.txt: one camera a line, intrinsics only.

COLMAP's pixel (0.5, 0.5) is the centre of the top-left pixel. Source: colmap.github.io/cameras.html
and COLMAP's src/colmap/sensor/models.h.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from egocap.cameras import foreign_lenses as lenses
from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.lens_fit import LensFit, as_kannala_brandt, exact, fit_kannala_brandt
from egocap.errors import FileError, InputError

_LINE = re.compile(r"^\d+\s+[A-Z][A-Z0-9_]*\s+\d+\s+\d+(\s+\S+)+$")
_CORNER = 0.5  # of the top-left pixel's centre from COLMAP's origin
Numbers = Sequence[float]


@dataclass(frozen=True)
class _Model:
    """How many focal lengths come first, and what follows the centre."""

    focals: int
    count: int
    plane: Callable[[Numbers], lenses.Plane]
    distortion: Callable[[Numbers], lenses.Distortion]


def _fisheye(_: Numbers) -> lenses.Plane:
    return lenses.equidistant()


def _pinhole(_: Numbers) -> lenses.Plane:
    return lenses.pinhole


def _brown(c: Numbers) -> lenses.Distortion:
    return lenses.brown_conrady(c)


def _radial(c: Numbers) -> lenses.Distortion:
    return lenses.radial_prism(c, (0.0, 0.0), (0.0, 0.0))


def _thin_prism(c: Numbers) -> lenses.Distortion:
    k1, k2, p1, p2, k3, k4, sx, sy = c
    return lenses.radial_prism((k1, k2, k3, k4), (p2, p1), (sx, sy))


def _prism(c: Numbers) -> lenses.Distortion:
    return lenses.radial_prism((), c[6:8], (c[8], c[10]), (c[9], c[11]))


_MODELS = {
    "SIMPLE_PINHOLE": _Model(1, 0, _pinhole, _radial),
    "PINHOLE": _Model(2, 0, _pinhole, _radial),
    "SIMPLE_RADIAL": _Model(1, 1, _pinhole, _radial),
    "RADIAL": _Model(1, 2, _pinhole, _radial),
    "OPENCV": _Model(2, 4, _pinhole, _brown),
    "FULL_OPENCV": _Model(2, 8, _pinhole, _brown),
    "FOV": _Model(2, 1, _pinhole, lambda c: lenses.field_of_view(c[0])),
    "THIN_PRISM_FISHEYE": _Model(2, 8, _fisheye, _thin_prism),
    "RAD_TAN_THIN_PRISM_FISHEYE": _Model(2, 12, lambda c: lenses.equidistant(c[:6]), _prism),
}
_EXACT = {"SIMPLE_RADIAL_FISHEYE": (1, 1), "RADIAL_FISHEYE": (1, 2), "OPENCV_FISHEYE": (2, 4),
          "SIMPLE_FISHEYE": (1, 0), "FISHEYE": (2, 0)}  # fmt: skip
"""Focal lengths and coefficients of Kannala-Brandt cameras."""


def is_colmap(text: str) -> bool:
    """Whether a text's first line that is no comment is a COLMAP camera."""
    return next((bool(_LINE.match(line)) for _, line in _lines(text)), False)


def parse_colmap(text: str, where: str | Path) -> CameraSet:
    """Cameras of a cameras.txt, named by their ids. Raises FileError with the line."""
    found = []
    for number, line in _lines(text):
        words = line.split()
        if not _LINE.match(line):
            raise FileError(where, "is not a camera", line=number,
                            valid="ID MODEL WIDTH HEIGHT PARAMETERS")  # fmt: skip
        try:
            lens = _lens(words[1], (int(words[2]), int(words[3])), [float(w) for w in words[4:]])
        except ValueError as error:
            raise FileError(where, str(error), line=number, valid="numbers") from None
        except InputError as error:
            raise FileError(where, str(error), line=number) from None
        found.append(SetCamera(f"camera{words[0]}", lens))
    return CameraSet(tuple(found))


def _lens(model: str, size: tuple[int, int], numbers: list[float]) -> LensFit:
    if model not in _MODELS and model not in _EXACT:
        raise InputError(f"unknown camera model '{model}'", valid=[*_EXACT, *_MODELS])
    focals, count = _EXACT.get(model) or (_MODELS[model].focals, _MODELS[model].count)
    if len(numbers) != focals + 2 + count:
        raise InputError(f"{model} with {len(numbers)} parameters", valid=f"{focals + 2 + count}")
    focal = (numbers[0], numbers[focals - 1])
    centre = (numbers[focals] - _CORNER, numbers[focals + 1] - _CORNER)
    rest = numbers[focals + 2 :]
    if model in _EXACT:
        k = tuple(rest) + (4 - count) * (0.0,)
        affine = ((focal[0], 0.0), (0.0, focal[1]))
        return exact(Camera("kannala_brandt", *size, centre, affine, k))
    parts = _MODELS[model]
    project = lenses.projection(parts.plane(rest), parts.distortion(rest), focal, centre)
    return fit_kannala_brandt(project, *size)


def _lines(text: str) -> list[tuple[int, str]]:
    pairs = ((n, line.split("#", 1)[0].strip()) for n, line in enumerate(text.splitlines(), 1))
    return [(n, line) for n, line in pairs if line]


def format_colmap(cameras: CameraSet) -> tuple[str, float]:
    """OPENCV_FISHEYE cameras as text, and the largest error of a lens [px]."""
    lines, worst = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"], 0.0
    for i, each in enumerate(cameras.cameras, 1):
        lens = as_kannala_brandt(each.camera)
        camera, worst = lens.camera, max(worst, lens.max_px)
        (fx, _), (_, fy) = camera.affine
        centre = [c + _CORNER for c in camera.centre]
        numbers = " ".join(repr(float(n)) for n in (fx, fy, *centre, *camera.parameters))
        lines.append(f"{i} OPENCV_FISHEYE {camera.width} {camera.height} {numbers}")
    return "\n".join(lines) + "\n", worst
