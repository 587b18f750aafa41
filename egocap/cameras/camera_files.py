"""Calibration files: OCamCalib text, EgoRear / EgoWholeMocap JSON, and our own form.

OCamCalib (Scaramuzza) has x along the image's rows, y along its columns, and views along -z:
a pixel is row = c x + d y + row0, column = e x + y + column0, and its ray is (x, y, f(rho)). In the
OpenCV frame used here x and y are swapped and z is negated, so that
[column, row] = [column0, row0] + [[1, e], [d, c]] @ [x, y] and theta = atan2(rho, -f(rho)).
The EgoRear and EgoWholeMocap files hold the same numbers with the centre as (column, row); their
own code does not use `affine` (at most 0.2 px in the published files), which is read as OCamCalib's
c, d, e here.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, pi, radians
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from egocap.cameras.camera import MAX_PIXELS, Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.formats import read_foreign
from egocap.cameras.lens_fit import exact
from egocap.errors import FileError, InputError
from egocap.schema import Number, Strict, checked, read_json, read_text

Pair = tuple[Number, Number]
Side = Annotated[int, Field(strict=True, ge=1, le=MAX_PIXELS, description="pixels")]


class CameraSpec(Strict):
    """A camera in EgoCap's own format."""

    model: Literal["equidistant", "kannala_brandt", "ocam"]
    width: Side
    height: Side
    centre: Pair | None = Field(
        default=None, description="pixel of the optical axis; default the middle"
    )
    focal: Number | Pair | None = Field(
        default=None, description="pixels per radian, one or (x, y)"
    )
    affine: tuple[Pair, Pair] | None = Field(default=None, description="2x2, instead of focal")
    fov: Number | None = Field(
        default=None, gt=0, le=360, description="full field of view, degrees"
    )
    max_angle: Number | None = Field(
        default=None, gt=0, le=pi, description="radians off axis, instead of fov"
    )
    parameters: tuple[Number, ...] = Field(
        default=(), max_length=32, description="of the lens model"
    )

    @model_validator(mode="after")
    def _one_of_each(self) -> CameraSpec:
        if self.fov is not None and self.max_angle is not None:
            raise ValueError("give fov (degrees) or max_angle (radians), not both")
        if self.focal is not None and self.affine is not None:
            raise ValueError("give focal or affine, not both")
        if any(not f > 0 for f in np.atleast_1d(1.0 if self.focal is None else self.focal)):
            raise ValueError("focal must be above zero")
        if self.model == "kannala_brandt" and self.focal is None and self.affine is None:
            raise ValueError("a kannala_brandt camera needs focal or affine")
        if self.model == "equidistant" and self.focal is self.affine is self.fov is None:
            raise ValueError("an equidistant camera needs focal, affine or fov")
        return self

    def camera(self) -> Camera:
        """Make the camera. Without focal lengths, `fov` spans the width of the image."""
        affine = self.affine
        if affine is None:
            focal = self.focal
            if focal is None and self.fov is not None and self.model == "equidistant":
                focal = self.width / radians(self.fov)
            fx, fy = (float(f) for f in np.broadcast_to(1.0 if focal is None else focal, 2))
            affine = ((fx, 0.0), (0.0, fy))
        return Camera(
            self.model,
            self.width,
            self.height,
            self.centre or ((self.width - 1) / 2, (self.height - 1) / 2),
            affine,
            self.parameters,
            radians(self.fov) / 2 if self.fov is not None else self.max_angle,  # type: ignore
        )


class OCamFile(Strict):
    """The JSON of EgoRear and EgoWholeMocap; keys without lens data are ignored."""

    model_config = ConfigDict(extra="ignore")

    size: tuple[Side, Side] = Field(description="width, height")
    image_center: Pair | None = Field(default=None, description="column, row")
    intrinsic: list[list[Number]] | None = Field(
        default=None, description="its last column replaces image_center"
    )
    polynomialC2W: tuple[Number, ...] = Field(min_length=1, max_length=32)
    affine: tuple[Number, Number, Number] = (1.0, 0.0, 0.0)
    imageCircleRadius: Number | None = Field(default=None, gt=0)

    @model_validator(mode="after")
    def _has_centre(self) -> OCamFile:
        rows = self.intrinsic
        if self.image_center is None and (not rows or len(rows) < 2 or min(map(len, rows[:2])) < 3):
            raise ValueError("give image_center (column, row), or a 3x3 intrinsic matrix")
        return self

    def camera(self) -> Camera:
        """Make the camera; its field of view ends at the image circle."""
        centre = self.image_center
        if centre is None:
            assert self.intrinsic is not None
            centre = (self.intrinsic[0][2], self.intrinsic[1][2])
        return _ocam(self.size, centre, self.polynomialC2W, self.affine, self.imageCircleRadius)


def camera_from_dict(data: Any, where: str | Path = "camera", prefix: str = "") -> Camera:
    """Make a camera from a dictionary: a `CameraSpec` (as `Camera.to_dict`) or an `OCamFile`.

    `where` names the file and `prefix` the key in errors. Raises FileError.
    """
    if isinstance(data, Camera):
        return data
    if not isinstance(data, dict):
        raise FileError(where, "a camera must be a table of keys", key=prefix or None)
    spec = checked(OCamFile if "polynomialC2W" in data else CameraSpec, data, where, prefix)
    try:
        return spec.camera()
    except InputError as error:
        raise FileError(where, str(error), key=prefix or None) from None


def load_camera(path: str | Path) -> Camera:
    """Read a calibration file of one camera, of any format of `egocap.cameras.formats`.

    Raises FileError, also for a file of several cameras.
    """
    cameras = read_cameras(path).cameras
    if len(cameras) != 1:
        raise FileError(path, f"holds {len(cameras)} cameras: {', '.join(c.name for c in cameras)}",
                        valid="one camera; egocap rig convert makes a rig of several")  # fmt: skip
    return cameras[0].camera


def read_cameras(path: str | Path, size: tuple[int, int] | None = None) -> CameraSet:
    """The cameras of a calibration file; the format is told by its content.

    `size` (width, height) is for formats that do not hold the image size. Raises FileError.
    """
    path = Path(path)
    foreign = read_foreign(path, size)
    if foreign is not None:
        return foreign
    if path.suffix.lower() == ".json":
        camera = camera_from_dict(read_json(path), path)
    else:
        camera = parse_ocam_text(read_text(path), path)
    return CameraSet((SetCamera(path.stem, exact(camera)),))


def parse_ocam_text(text: str, where: str | Path) -> Camera:
    """Parse OCamCalib's calib_results.txt: '#' comments and five lines of numbers.

    The lines: polynomial (after its length), inverse polynomial (likewise; not used), centre as row
    and column, affine c d e, height and width. Raises FileError naming the line.
    """
    names = ("polynomial", "inverse polynomial", "centre (row column)", "affine (c d e)", "size")
    lines: list[tuple[int, list[float]]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#", 1)[0].split()
        if words:
            lines.append((number, _numbers(words, where, number)))
    if len(lines) != 5:
        raise FileError(where, f"{len(lines)} lines of numbers", valid="; ".join(names))
    for (number, values), wanted, name in zip(lines, (None, None, 2, 3, 2), names, strict=True):
        if wanted is None and not values[0] == len(values) - 1 > 0:
            problem = f"{name} announces {values[0]:g} coefficients and has {len(values) - 1}"
            raise FileError(where, problem, line=number)
        if wanted is not None and len(values) != wanted:
            raise FileError(where, f"{len(values)} numbers", line=number, valid=name)
    (_, polynomial), _, (_, centre), (_, affine), (at, size) = lines
    if not all(n == int(n) and 1 <= n <= MAX_PIXELS for n in size):
        raise FileError(where, f"image size {size}", line=at, valid=f"1 to {MAX_PIXELS} pixels")
    try:
        return _ocam(
            (int(size[1]), int(size[0])), (centre[1], centre[0]), polynomial[1:], affine, None
        )
    except InputError as error:
        raise FileError(where, str(error)) from None


def _numbers(words: list[str], where: str | Path, line: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FileError(where, str(error), line=line, valid="numbers") from None
    if not all(isfinite(v) for v in values):
        raise FileError(where, "a number is not finite", line=line)
    return values


def _ocam(
    size: tuple[int, int],
    centre: tuple[float, float],
    polynomial: Sequence[float],
    affine: Sequence[float],
    circle: float | None,
) -> Camera:
    c, d, e = affine
    angle = None
    if circle is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            z = -np.polynomial.polynomial.polyval(circle, np.array(polynomial))
        angle = float(np.arctan2(circle, z))
        if not isfinite(angle):
            raise InputError("the polynomial overflows inside the image circle")
    (width, height), rows = size, ((1.0, e), (d, c))
    return Camera("ocam", width, height, centre, rows, tuple(polynomial), angle)  # type: ignore
