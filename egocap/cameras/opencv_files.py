"""OpenCV's calibration files, YAML or XML of cv2.FileStorage: fisheye, omnidir and pinhole cameras.

One camera: `camera_matrix` (or `K`), `distortion_coefficients` (or `D`), `xi` of omnidir. Two: the
same with 1 and 2 behind their names, and R, T, which map points of the first camera to the second.
Four coefficients are those of fisheye under the name D, and with `fisheye_model: 1`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras import foreign_lenses as lenses
from egocap.cameras.camera import Camera
from egocap.cameras.camera_set import CameraSet, SetCamera
from egocap.cameras.lens_fit import LensFit, as_kannala_brandt, exact, fit_kannala_brandt
from egocap.errors import FileError, InputError
from egocap.geometry import inverse, rigid

_MATRIX = ("camera_matrix{}", "cameraMatrix{}", "K{}", "M{}")
_DISTORTION = ("distortion_coefficients{}", "distCoeffs{}", "D{}")
_WIDTH = ("image_width", "image_Width", "imageWidth", "width")
_HEIGHT = ("image_height", "image_Height", "imageHeight", "height")
_SIZE = ("image_size", "imageSize", "size")


def parse_opencv(text: str, where: str | Path, size: tuple[int, int] | None = None) -> CameraSet:
    """The cameras of a file's text. `size` (width, height) is for files that do not hold it.

    Raises FileError with the key.
    """
    import cv2

    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        names = set(root.keys()) if root.isMap() else set()
    except (cv2.error, SystemError) as error:
        raise FileError(where, f"OpenCV cannot read it: {str(error).strip()[:200]}") from None
    read = {name: _value(storage.getNode(name)) for name in names}
    values = {name: value for name, value in read.items() if value is not None}
    for name in sorted(values):
        if not np.isfinite(values[name]).all():
            raise FileError(where, "holds numbers that are not finite", key=name)
    file = _File(values, Path(where), size)
    if "R" in values and "T" in values:
        first, second = file.lens("1"), file.lens("2")
        T = rigid(_rotation(values["R"], where), file.numbers("T", 3))
        return CameraSet(
            (SetCamera("left", first, np.eye(4)), SetCamera("right", second, inverse(T)))
        )
    return CameraSet((SetCamera(Path(where).stem or "camera", file.lens("")),))


class _File:
    """The values of a file and where they are."""

    def __init__(self, values: dict[str, Array], where: Path, size: tuple[int, int] | None) -> None:
        self._values, self._where, self._size = values, where, size

    def lens(self, suffix: str) -> LensFit:
        """The lens whose keys end in `suffix`."""
        name, K = self._first([n.format(suffix) for n in _MATRIX])
        if K.shape != (3, 3):
            raise FileError(self._where, f"has the shape {K.shape}", key=name, valid="3 x 3")
        key, D = self._first([n.format(suffix) for n in _DISTORTION])
        try:
            return self._lens(K, D.ravel(), key, suffix)
        except InputError as error:
            raise FileError(self._where, str(error), key=name) from None

    def _lens(self, K: Array, D: Array, key: str, suffix: str) -> LensFit:
        width, height = self._image_size()
        focal, centre, skew = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), float(K[0, 1])
        if (xi := self._values.get(f"xi{suffix}")) is not None:
            if D.size != 4:
                raise FileError(
                    self._where, f"{D.size} coefficients", key=key, valid="4 of omnidir"
                )
            project = lenses.projection(
                lenses.mei(float(xi.ravel()[0])), lenses.brown_conrady(D.tolist()), focal, centre,
                skew,
            )  # fmt: skip
            return fit_kannala_brandt(project, width, height)
        if self._is_fisheye(D, key):
            affine = ((float(focal[0]), skew), (0.0, float(focal[1])))  # K holds alpha f_x
            middle = (float(centre[0]), float(centre[1]))
            return exact(Camera("kannala_brandt", width, height, middle, affine, tuple(D.tolist())))
        project = lenses.projection(
            lenses.pinhole, lenses.brown_conrady(D.tolist()), focal, centre, skew
        )
        return fit_kannala_brandt(project, width, height)

    def _is_fisheye(self, D: Array, key: str) -> bool:
        if D.size not in (4, 5, 8, 12):
            raise FileError(self._where, f"{D.size} coefficients", key=key, valid="4, 5, 8 or 12")
        flag = self._values.get("fisheye_model")
        if flag is not None:
            if bool(flag.ravel()[0]) and D.size != 4:
                raise FileError(
                    self._where, f"{D.size} coefficients", key=key, valid="4 of fisheye"
                )
            return bool(flag.ravel()[0])
        if D.size == 4 and not key.startswith("D"):
            raise FileError(self._where, "4 coefficients fit fisheye and pinhole cameras", key=key,
                            valid="fisheye_model: 1 or 0 beside them")  # fmt: skip
        return D.size == 4

    def numbers(self, key: str, count: int) -> Float[Array, "n"]:
        """So many numbers."""
        values = self._values[key].ravel()
        if values.size != count:
            raise FileError(self._where, f"{values.size} numbers", key=key, valid=str(count))
        return values

    def _first(self, names: list[str]) -> tuple[str, Array]:
        for name in names:
            if (value := self._values.get(name)) is not None:
                return name, value
        raise FileError(self._where, "missing", key=names[0], valid=names)

    def _image_size(self) -> tuple[int, int]:
        if self._size is not None:
            return self._size
        pair = next((self._values[n].ravel() for n in _SIZE if n in self._values), None)
        if pair is None:
            width = next((self._values[n] for n in _WIDTH if n in self._values), None)
            height = next((self._values[n] for n in _HEIGHT if n in self._values), None)
            if width is None or height is None:
                raise FileError(self._where, "the image size is not in the file",
                                key="image_width", valid="image_width and image_height, or "
                                "--size WIDTH HEIGHT of egocap rig convert")  # fmt: skip
            pair = np.array([width.ravel()[0], height.ravel()[0]])
        return int(pair[0]), int(pair[1])


def _value(node: Any) -> Array | None:
    """Numbers of a node, a matrix by its rows and columns; None for text and other maps."""
    if node.isReal() or node.isInt():
        return np.array([node.real()])
    if node.isSeq():
        items = [node.at(i) for i in range(node.size())]
        numeric = all(item.isReal() or item.isInt() for item in items)
        return np.array([item.real() for item in items]) if numeric else None
    if not node.isMap() or "data" not in node.keys():  # noqa: SIM118 (no mapping)
        return None
    # Not node.mat(): it allocates whatever a damaged file asks for.
    data, sizes = _value(node.getNode("data")), _value(node.getNode("sizes"))
    if sizes is None:
        sizes = np.array([node.getNode(name).real() for name in ("rows", "cols")])
    if data is None or data.size != sizes.prod():
        return None
    return data.reshape(sizes.astype(int))


def _rotation(value: Array, where: str | Path) -> Float[Array, "3 3"]:
    import cv2

    R = cv2.Rodrigues(value.ravel())[0] if value.size == 3 else value
    if R.shape != (3, 3) or abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise FileError(where, "is not a rotation", key="R", valid="a 3 x 3 matrix or 3 numbers")
    u, _, v = np.linalg.svd(R)
    return u @ v


def format_opencv(cameras: CameraSet, xml: bool = False) -> tuple[str, float]:
    """Fisheye cameras, one or a stereo pair, as text, and the largest error of a lens [px].

    Raises InputError for more than two cameras.
    """
    import cv2

    if len(cameras.cameras) > 2:
        raise InputError(f"{len(cameras.cameras)} cameras", valid="one or two in an OpenCV file")
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    flags |= cv2.FILE_STORAGE_FORMAT_XML if xml else cv2.FILE_STORAGE_FORMAT_YAML
    storage, worst = cv2.FileStorage("", flags), 0.0
    pair = len(cameras.cameras) == 2
    sizes = {(c.camera.width, c.camera.height) for c in cameras.cameras}
    if len(sizes) > 1:
        raise InputError("the two cameras' images differ in size", valid="one size")
    for key, length in zip(("image_width", "image_height"), *sizes, strict=True):
        storage.write(key, length)
    storage.write("fisheye_model", 1)
    for i, each in enumerate(cameras.cameras, 1):
        lens = as_kannala_brandt(each.camera)
        worst = max(worst, lens.max_px)
        (fx, _), (_, fy) = lens.camera.affine
        K = np.array(
            [[fx, 0.0, lens.camera.centre[0]], [0.0, fy, lens.camera.centre[1]], [0, 0, 1]]
        )
        D = np.array(lens.camera.parameters)[:, None]
        storage.write(f"K{i}" if pair else "camera_matrix", K)
        storage.write(f"D{i}" if pair else "distortion_coefficients", D)
    for each in cameras.cameras[1:]:
        place = each.T_first_camera
        if place is None:
            raise InputError("the place of the second camera is unknown", valid="a rig")
        T = inverse(place)
        storage.write("R", np.ascontiguousarray(T[:3, :3]))
        storage.write("T", np.ascontiguousarray(T[:3, 3:]))
    return storage.releaseAndGetString(), worst
