"""ROS's camera_info YAML, as camera_calibration writes it: one camera.

Source: wiki.ros.org/camera_calibration_parsers and sensor_msgs/distortion_models.h.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field

from egocap.cameras import foreign_lenses as lenses
from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.lens_fit import LensFit, as_kannala_brandt, exact, fit_kannala_brandt
from egocap.errors import FileError, InputError
from egocap.schema import Number, Strict, checked


class _Matrix(Strict):
    rows: int
    cols: int
    data: tuple[Number, ...]


class _CameraInfo(Strict):
    model_config = ConfigDict(extra="ignore")

    image_width: int = Field(ge=1)
    image_height: int = Field(ge=1)
    camera_name: str = "camera"
    camera_matrix: _Matrix
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant", "fisheye"]
    distortion_coefficients: _Matrix

    def lens(self) -> LensFit:
        K, D = self.camera_matrix.data, self.distortion_coefficients.data
        if len(K) != 9:
            raise InputError(f"a camera_matrix of {len(K)} numbers", valid="9")
        wanted = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12)}.get(
            self.distortion_model, (4,)
        )
        if len(D) not in wanted:
            raise InputError(f"{len(D)} distortion_coefficients of '{self.distortion_model}'",
                             valid=" or ".join(map(str, wanted)))  # fmt: skip
        size, focal, centre = (self.image_width, self.image_height), (K[0], K[4]), (K[2], K[5])
        if self.distortion_model in ("equidistant", "fisheye"):
            affine = ((focal[0], K[1]), (0.0, focal[1]))
            return exact(Camera("kannala_brandt", *size, centre, affine, tuple(D)))
        distortion = lenses.brown_conrady(D)
        return fit_kannala_brandt(
            lenses.projection(lenses.pinhole, distortion, focal, centre, K[1]), *size
        )


def is_ros(data: Any) -> bool:
    """Whether a YAML document is a camera_info."""
    return isinstance(data, dict) and {"camera_matrix", "distortion_model"} <= data.keys()


def parse_ros(data: dict[str, Any], where: str | Path) -> CameraSet:
    """The camera of a camera_info document. Raises FileError with the key."""
    info = checked(_CameraInfo, data, where)
    try:
        return CameraSet((SetCamera(info.camera_name, info.lens()),))
    except InputError as error:
        raise FileError(where, str(error), key="camera_matrix") from None


def format_ros(cameras: CameraSet) -> tuple[str, float]:
    """One equidistant camera as YAML, and the error of its lens [px]."""
    import yaml

    (each,) = cameras.cameras
    lens = as_kannala_brandt(each.camera)
    camera = lens.camera
    (fx, _), (_, fy) = camera.affine
    cx, cy = camera.centre
    data = {
        "image_width": camera.width, "image_height": camera.height, "camera_name": each.name,
        "camera_matrix": _matrix(3, 3, (fx, 0, cx, 0, fy, cy, 0, 0, 1)),
        "distortion_model": "equidistant",
        "distortion_coefficients": _matrix(1, 4, camera.parameters),
        "rectification_matrix": _matrix(3, 3, (1, 0, 0, 0, 1, 0, 0, 0, 1)),
        "projection_matrix": _matrix(3, 4, (fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0)),
    }  # fmt: skip
    return yaml.safe_dump(data, default_flow_style=None, sort_keys=False), lens.max_px


def _matrix(rows: int, columns: int, values: tuple[float, ...]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": [float(v) for v in values]}
