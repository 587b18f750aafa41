"""Project Aria's calibration JSON: the device's own, and the form of data sets as HOT3D.

The device's: `CameraCalibrations`, each with `Projection` (FisheyeRadTanThinPrism, fitted; or
KannalaBrandtK3) and `T_Device_Camera`; also the first line of online_calibration.jsonl. Data sets':
`projection_model_type`, `projection_params`, image size, and `T_device_from_camera`.
Source: facebookresearch/projectaria_tools, technical specification of calibration.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from egocap.cameras import foreign_lenses as lenses
from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.lens_fit import LensFit, as_kannala_brandt, exact, fit_kannala_brandt
from egocap.errors import FileError, InputError
from egocap.geometry import inverse, matrix_to_quaternion, quaternion_to_matrix, rigid
from egocap.schema import Number, Strict, checked

Vector = tuple[Number, Number, Number]
SIZES = {"camera-slam-left": (640, 480), "camera-slam-right": (640, 480)}
"""Image sizes of a device whose file does not hold them."""
_FISHEYE = ("FISHEYE624", "FISHEYERADTANTHINPRISM")
_KANNALA = ("KANNALA_BRANDT_K3", "KANNALABRANDTK3")


class _Loose(Strict):
    model_config = ConfigDict(extra="ignore")


class _Projection(_Loose):
    Name: str
    Params: tuple[Number, ...]


class _Pose(_Loose):
    Translation: Vector
    UnitQuaternion: tuple[Number, Vector]


class _Config(_Loose):
    ImageWidth: int = Field(ge=1)
    ImageHeight: int = Field(ge=1)
    MaxSolidAngle: Number | None = None


class _DeviceCamera(_Loose):
    Label: str
    Projection: _Projection
    T_Device_Camera: _Pose
    ConfigData: _Config | None = None


class _Device(_Loose):
    CameraCalibrations: tuple[_DeviceCamera, ...] = Field(min_length=1)


class _DataPose(_Loose):
    quaternion_wxyz: tuple[Number, Number, Number, Number]
    translation_xyz: Vector


class _DataCamera(_Loose):
    label: str = "camera"
    projection_model_type: str
    projection_params: tuple[Number, ...]
    image_width: int = Field(ge=1)
    image_height: int = Field(ge=1)
    max_solid_angle: Number | None = None
    T_device_from_camera: _DataPose | None = None


def is_aria(data: Any) -> bool:
    """Whether a JSON object is Aria's."""
    keys = {"CameraCalibrations", "projection_model_type"}
    return isinstance(data, dict) and not keys.isdisjoint(data)


def parse_aria(
    data: dict[str, Any], where: str | Path, size: tuple[int, int] | None = None
) -> CameraSet:
    """The cameras of a device. `size` (width, height) is for files that do not hold it.

    Raises FileError with the key.
    """
    if "CameraCalibrations" not in data:
        entry = checked(_DataCamera, data, where)
        try:
            of_image = (entry.image_width, entry.image_height)
            lens = _lens(
                entry.projection_model_type, entry.projection_params, of_image,
                entry.max_solid_angle,
            )  # fmt: skip
        except InputError as error:
            raise FileError(where, str(error), key="projection_params") from None
        return CameraSet((SetCamera(entry.label, lens),))
    found, places = [], []
    for i, entry in enumerate(checked(_Device, data, where).CameraCalibrations):
        config, key = entry.ConfigData, f"CameraCalibrations.{i}"
        of_image = SIZES.get(entry.Label, size)
        if config is not None:
            of_image = (config.ImageWidth, config.ImageHeight)
        if of_image is None:
            continue  # an eye camera or the colour camera, at a size that the file does not say
        widest = config.MaxSolidAngle if config else None
        try:
            lens = _lens(entry.Projection.Name, entry.Projection.Params, of_image, widest)
        except InputError as error:
            raise FileError(where, str(error), key=f"{key}.Projection") from None
        w, xyz = entry.T_Device_Camera.UnitQuaternion
        R = quaternion_to_matrix(np.array([w, *xyz]))
        places.append(rigid(R, np.array(entry.T_Device_Camera.Translation)))
        found.append((entry.Label, lens))
    if not found:
        raise FileError(where, "no camera of known image size", key="CameraCalibrations",
                        valid=f"ConfigData with ImageWidth and ImageHeight, {', '.join(SIZES)}, or "
                        "--size WIDTH HEIGHT of egocap rig convert")  # fmt: skip
    first = inverse(places[0])
    return CameraSet(
        tuple(SetCamera(n, lens, first @ T) for (n, lens), T in zip(found, places, strict=True))
    )


def _lens(
    name: str, parameters: tuple[float, ...], size: tuple[int, int], widest: float | None
) -> LensFit:
    kind = name.rpartition(".")[2].upper()
    if kind in _KANNALA:
        if len(parameters) != 8:
            raise InputError(f"{name} with {len(parameters)} parameters", valid="8")
        fx, fy, cx, cy, *k = parameters
        affine = ((fx, 0.0), (0.0, fy))
        lens = Camera("kannala_brandt", *size, (cx, cy), affine, tuple(k), widest)  # type: ignore[arg-type]
        return exact(lens)
    if kind not in _FISHEYE:
        raise InputError(f"unknown camera model '{name}'", valid="Fisheye624, KannalaBrandtK3")
    if len(parameters) not in (15, 16):
        raise InputError(f"{name} with {len(parameters)} parameters", valid="15, or 16 with f_y")
    focals = 1 if len(parameters) == 15 else 2
    focal, centre = (parameters[0], parameters[focals - 1]), parameters[focals : focals + 2]
    rest = parameters[focals + 2 :]
    prism = lenses.radial_prism((), rest[6:8], (rest[8], rest[10]), (rest[9], rest[11]))
    project = lenses.projection(lenses.equidistant(rest[:6]), prism, focal, centre)
    # Aria's "solid angle" is the largest angle off the axis, radians.
    return fit_kannala_brandt(project, *size, widest=np.pi if widest is None else widest)


def format_aria(cameras: CameraSet) -> tuple[dict[str, Any], float]:
    """`CameraCalibrations` with KannalaBrandtK3 lenses, and the largest error of a lens [px]."""
    entries, worst = [], 0.0
    for each in cameras.cameras:
        lens = as_kannala_brandt(each.camera)
        camera, worst = lens.camera, max(worst, lens.max_px)
        place = np.eye(4) if each.T_first_camera is None else each.T_first_camera
        w, *xyz = matrix_to_quaternion(place[:3, :3]).tolist()
        (fx, _), (_, fy) = camera.affine
        entries.append({
            "Label": each.name, "Calibrated": True,
            "Projection": {"Name": "KannalaBrandtK3",
                           "Params": [fx, fy, *camera.centre, *camera.parameters]},
            "T_Device_Camera": {"Translation": place[:3, 3].tolist(), "UnitQuaternion": [w, xyz]},
            "ConfigData": {"ImageWidth": camera.width, "ImageHeight": camera.height,
                           "MaxSolidAngle": camera.max_angle},
        })  # fmt: skip
    return {"CameraCalibrations": entries}, worst
