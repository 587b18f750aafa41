"""Kalibr's camera chain (camchain.yaml): pinhole, omni, eucm and ds cameras with their extrinsics.

`T_cn_cnm1` maps points of the camera before into the camera. Models that are not equidistant are
fitted (`lens_fit`). Source: github.com/ethz-asl/kalibr/wiki/yaml-formats.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from egocap.cameras import foreign_lenses as lenses
from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.lens_fit import LensFit, as_kannala_brandt, exact, fit_kannala_brandt
from egocap.errors import FileError, InputError
from egocap.geometry import inverse
from egocap.schema import Number, Strict, checked

Row = tuple[Number, Number, Number, Number]

_INTRINSICS = {"pinhole": 4, "omni": 5, "eucm": 6, "ds": 6}
_COEFFICIENTS = {"none": 0, "fov": 1, "radtan": 4, "equidistant": 4}


class _KalibrCamera(Strict):
    model_config = ConfigDict(extra="ignore")

    camera_model: Literal["pinhole", "omni", "eucm", "ds"]
    intrinsics: tuple[Number, ...]
    distortion_model: Literal["radtan", "equidistant", "fov", "none"] = "none"
    distortion_coeffs: tuple[Number, ...] = ()
    resolution: tuple[int, int]
    T_cn_cnm1: tuple[Row, Row, Row, Row] | None = Field(default=None)

    @model_validator(mode="after")
    def _counts(self) -> _KalibrCamera:
        if len(self.intrinsics) != (count := _INTRINSICS[self.camera_model]):
            raise ValueError(f"'{self.camera_model}' has {count} intrinsics")
        if len(self.distortion_coeffs) != (count := _COEFFICIENTS[self.distortion_model]):
            raise ValueError(f"'{self.distortion_model}' has {count} distortion_coeffs")
        if self.distortion_model == "equidistant" and self.camera_model != "pinhole":
            raise ValueError("equidistant distortion belongs to a pinhole camera")
        return self

    def lens(self) -> LensFit:
        *own, fu, fv, pu, pv = self.intrinsics
        if self.distortion_model == "equidistant":
            affine = ((fu, 0.0), (0.0, fv))
            camera = Camera("kannala_brandt", *self.resolution, (pu, pv), affine,
                            self.distortion_coeffs)  # fmt: skip
            return exact(camera)
        plane = {
            "pinhole": lambda: lenses.pinhole, "omni": lambda: lenses.mei(*own),
            "eucm": lambda: lenses.extended_unified(*own),
            "ds": lambda: lenses.double_sphere(*own),
        }[self.camera_model]()  # fmt: skip
        distortion = {
            "none": lambda: lenses.undistorted,
            "radtan": lambda: lenses.brown_conrady(self.distortion_coeffs),
            "fov": lambda: lenses.field_of_view(*self.distortion_coeffs),
        }[self.distortion_model]()
        project = lenses.projection(plane, distortion, (fu, fv), (pu, pv))
        return fit_kannala_brandt(project, *self.resolution)


def is_kalibr(data: Any) -> bool:
    """Whether a YAML document is a camera chain."""
    return isinstance(data, dict) and isinstance(data.get("cam0"), dict)


def parse_kalibr(data: dict[str, Any], where: str | Path) -> CameraSet:
    """The cameras of a chain, cam0, cam1, ... Raises FileError with the key."""
    found: list[SetCamera] = []
    T_first = np.eye(4)
    for i in range(sum(key.startswith("cam") for key in map(str, data))):
        name = f"cam{i}"
        if name not in data:
            raise FileError(where, "missing", key=name, valid="cam0, cam1, ... without a gap")
        entry = checked(_KalibrCamera, data[name], where, name)
        try:
            lens = entry.lens()
        except InputError as error:
            raise FileError(where, str(error), key=name) from None
        if i:
            if entry.T_cn_cnm1 is None:
                raise FileError(where, "missing", key=f"{name}.T_cn_cnm1", valid="a 4 x 4 matrix")
            T_first = T_first @ inverse(rigid_matrix(entry.T_cn_cnm1, where, f"{name}.T_cn_cnm1"))
        found.append(SetCamera(name, lens, T_first))
    return CameraSet(tuple(found))


def rigid_matrix(rows: Any, where: str | Path, key: str) -> np.ndarray:
    """A rigid 4 x 4 transform whose digits are rounded. Raises FileError."""
    T = np.array(rows, float)
    R = T[:3, :3]
    if abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0 or any(T[3] != (0, 0, 0, 1)):
        raise FileError(where, "is not a rigid transform", key=key,
                        valid="an orthonormal right-handed rotation, last row 0 0 0 1")  # fmt: skip
    u, _, v = np.linalg.svd(R)
    T[:3, :3] = u @ v
    return T


def format_kalibr(cameras: CameraSet) -> tuple[str, float]:
    """A chain of pinhole-equidistant cameras as YAML, and the largest error of a lens [px]."""
    import yaml

    data: dict[str, Any] = {}
    worst, before = 0.0, np.eye(4)
    for i, each in enumerate(cameras.cameras):
        lens = as_kannala_brandt(each.camera)
        camera, worst = lens.camera, max(worst, lens.max_px)
        data[f"cam{i}"] = {
            "camera_model": "pinhole",
            "distortion_coeffs": list(camera.parameters),
            "distortion_model": "equidistant",
            "intrinsics": [camera.affine[0][0], camera.affine[1][1], *camera.centre],
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{each.name}/image_raw",
        }
        if i:
            if each.T_first_camera is None:
                raise InputError(f"the place of '{each.name}' is unknown", valid="a rig")
            data[f"cam{i}"]["T_cn_cnm1"] = (inverse(each.T_first_camera) @ before).tolist()
            before = each.T_first_camera
    return yaml.safe_dump(data, default_flow_style=None), worst
