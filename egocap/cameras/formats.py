"""Calibration files of other programs: which format a file has, and how it is read and written.

Reading tells the format by content; writing takes it by name or suffix.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from egocap.cameras.aria import format_aria, is_aria, parse_aria
from egocap.cameras.camera_set import CameraSet
from egocap.cameras.colmap import format_colmap, is_colmap, parse_colmap
from egocap.cameras.kalibr import format_kalibr, is_kalibr, parse_kalibr
from egocap.cameras.ocam_files import ocam_calibration, ocam_error, ocam_text
from egocap.cameras.opencv_files import format_opencv, parse_opencv
from egocap.cameras.ros import format_ros, is_ros, parse_ros
from egocap.errors import FileError, InputError
from egocap.schema import MOST_TOML, parsed, read_json, read_text

YAML = (".yaml", ".yml")
FOREIGN_SUFFIXES = (*YAML, ".xml", ".jsonl")
"""Of files that never hold a rig of ours."""
MOST_VALUES = 100_000
"""In a YAML file, with its aliases written out."""

Text = Callable[[CameraSet], tuple[str, float]]
"""Writes cameras as text; the number is the largest error of a lens, pixels."""


def read_foreign(path: Path, size: tuple[int, int] | None = None) -> CameraSet | None:
    """Cameras of a file of another program; None for our own and OCam files. Raises FileError."""
    suffix = path.suffix.lower()
    if suffix in (".json", ".jsonl"):
        data = _first_line(path) if suffix == ".jsonl" else read_json(path)
        return parse_aria(data, path, size) if is_aria(data) else None
    text = read_text(path, MOST_TOML)
    if "<opencv_storage>" in text or text.startswith("%YAML:1") or "!!opencv-matrix" in text:
        return parse_opencv(text, path, size)
    if suffix in YAML:
        return _yaml(text, path)
    return parse_colmap(text, path) if is_colmap(text) else None


def _first_line(path: Path) -> dict[str, Any]:
    data = parsed(read_text(path).partition("\n")[0], path, line=1)
    if not is_aria(data):
        raise FileError(path, "no calibration", line=1, valid="Aria's online_calibration.jsonl")
    return data


def _written_out(value: Any, known: dict[int, int]) -> int:
    """Number of values in a tree with its aliases written out. ValueError if it holds itself."""
    if not isinstance(value, dict | list):
        return 1
    if id(value) not in known:
        known[id(value)] = -1  # in work
        inside = value.values() if isinstance(value, dict) else value
        known[id(value)] = 1 + sum(_written_out(item, known) for item in inside)
    if known[id(value)] < 0:
        raise ValueError("an alias (*name) holds itself")
    return known[id(value)]


def _yaml(text: str, path: Path) -> CameraSet:
    import yaml

    try:
        data = yaml.safe_load(text)
        if _written_out(data, {}) > MOST_VALUES:
            raise ValueError(f"aliases (*name) stand for more than {MOST_VALUES:,} values")
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or "not readable"
        raise FileError(
            path, f"not YAML: {problem}", line=None if mark is None else mark.line + 1
        ) from None
    except (RecursionError, ValueError) as error:
        raise FileError(path, f"not YAML: {error or 'nested too deeply'}") from None
    if is_kalibr(data):
        return parse_kalibr(data, path)
    if is_ros(data):
        return parse_ros(data, path)
    raise FileError(path, "no calibration that is known",
                    valid="a Kalibr camera chain (cam0), a ROS camera_info (camera_matrix, "
                    "distortion_model) or a file of cv2.FileStorage")  # fmt: skip


def _ocam_json(cameras: CameraSet) -> tuple[str, float]:
    (each,) = cameras.cameras
    data = ocam_calibration(each.camera, each.name)
    return json.dumps(data, indent=1) + "\n", ocam_error(each.camera, data)


def _ocam_text(cameras: CameraSet) -> tuple[str, float]:
    (each,) = cameras.cameras
    return ocam_text(each.camera)


def _aria(cameras: CameraSet) -> tuple[str, float]:
    data, worst = format_aria(cameras)
    return json.dumps(data, indent=1) + "\n", worst


WRITERS: dict[str, tuple[Text, bool]] = {
    "kalibr": (format_kalibr, True),
    "opencv": (format_opencv, True),
    "opencv-xml": (lambda cameras: format_opencv(cameras, xml=True), True),
    "colmap": (format_colmap, True),
    "aria": (_aria, True),
    "ros": (format_ros, False),
    "ocam": (_ocam_text, False),
    "unrealego": (_ocam_json, False),
}
"""Format -> its writer, and whether one file holds several cameras."""


def format_cameras(cameras: CameraSet, format: str, path: Path) -> tuple[dict[Path, str], float]:
    """Texts of the files that hold cameras in a format, and the largest error of a lens [px].

    A format of one camera makes a file for each, NAME.VIEW.SUFFIX. Raises InputError.
    """
    if format not in WRITERS:
        raise InputError(f"unknown format '{format}'", valid=WRITERS)
    write, several = WRITERS[format]
    if several or len(cameras.cameras) == 1:
        text, worst = write(cameras)
        return {path: text}, worst
    files, errors = {}, []
    for each in cameras.cameras:
        text, error = write(CameraSet((each,)))
        files[path.with_name(f"{path.stem}.{_plain(each.name)}{path.suffix}")] = text
        errors.append(error)
    return files, max(errors)


def _plain(name: str) -> str:
    """A camera's name as part of a file's name."""
    return re.sub(r"[^\w-]+", "_", name)[:40]
