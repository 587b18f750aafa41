"""Rig files: TOML for people, JSON (also with exact matrices) for programs.

Angles are in degrees. A camera without rotation points along the head's forward axis, image up =
head up; `pitch` turns the optical axis down, `yaw` to the left, `roll` turns the camera clockwise
about its optical axis as seen from behind it.
"""

from __future__ import annotations

import json
from math import degrees
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import camera_from_dict, load_camera, read_cameras
from egocap.cameras.camera_set import CameraSet
from egocap.cameras.formats import FOREIGN_SUFFIXES
from egocap.cameras.rig import SCHEMA, Mount, Rig, camera_rotation
from egocap.errors import FileError, InputError
from egocap.files import write_atomically
from egocap.geometry import rigid
from egocap.schema import Number, Strict, checked, read_json, read_toml, refuse_newer

MAX_FOV = 300.0  # degrees; beyond any lens and the valid range of the polynomial models

Metres = tuple[Number, Number, Number]
Matrix = tuple[Metres, Metres, Metres]
Row4 = tuple[Number, Number, Number, Number]


class CameraEntry(Strict):
    """One camera of a rig: position, orientation and lens."""

    name: str = Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_-]+$")
    position: Metres = Field(description="metres, head frame: forward, left, up of the skull base")
    pitch: Number = Field(default=0.0, ge=-180, le=180, description="degrees below horizontal")
    yaw: Number = Field(default=0.0, ge=-180, le=180, description="degrees to the left")
    roll: Number = Field(default=0.0, ge=-180, le=180, description="degrees about the optical axis")
    rotation: Matrix | None = Field(default=None, description="R_head_camera instead of the angles")
    lens: dict[str, Any] | None = Field(default=None, description="overrides the rig's lens")
    calibration: str | None = Field(
        default=None, description="file in the rig file's folder, instead of a lens"
    )

    @model_validator(mode="after")
    def _consistent(self) -> CameraEntry:
        if np.abs(self.position).max() > 2.0:
            raise ValueError("position is more than 2 m from the head")
        if self.rotation is not None:
            if {"pitch", "yaw", "roll"} & self.model_fields_set:
                raise ValueError("give rotation or pitch, yaw and roll, not both")
            R = np.array(self.rotation)
            if abs(R @ R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(R) < 0:
                raise ValueError("rotation is not orthonormal and right-handed")
        if self.lens is not None and self.calibration is not None:
            raise ValueError("give lens or calibration, not both")
        return self

    def T_head_camera(self) -> np.ndarray:
        """Pose of the camera in the head frame."""
        if self.rotation is not None:
            u, _, v = np.linalg.svd(np.array(self.rotation))  # the digits are rounded
            return rigid(u @ v, np.array(self.position))
        return rigid(camera_rotation(self.pitch, self.yaw, self.roll), np.array(self.position))


class Stereo(Strict):
    """Two mirror-symmetric cameras, 'left' and 'right'."""

    baseline: Number = Field(gt=0, le=2, description="metres between the cameras")
    forward: Number = Field(ge=-2, le=2, description="metres in front of the skull base")
    up: Number = Field(ge=-2, le=2, description="metres above the skull base")
    pitch: Number = Field(ge=-180, le=180, description="degrees below horizontal")
    toe_out: Number = Field(
        default=0.0, ge=-90, le=90, description="degrees each camera turns outwards"
    )
    calibration: tuple[str, str] | None = Field(default=None, description="files: left, right")

    def entries(self) -> tuple[CameraEntry, CameraEntry]:
        """The left and the right camera."""
        files = self.calibration or (None, None)
        left, right = (
            CameraEntry(
                name=name,
                position=(self.forward, side * self.baseline / 2, self.up),
                pitch=self.pitch,
                yaw=side * self.toe_out,
                calibration=file,
            )
            for name, side, file in zip(("left", "right"), (1, -1), files, strict=True)
        )
        return left, right


class RigFile(Strict):
    """A rig file written by hand."""

    name: str = Field(min_length=1, max_length=80)
    description: str = ""
    frame_rate: Number = Field(default=30.0, gt=0, le=1000, description="Hz")
    lens: dict[str, Any] | None = Field(default=None, description="of cameras without their own")
    stereo: Stereo | None = None
    cameras: tuple[CameraEntry, ...] | None = Field(default=None, min_length=1, max_length=16)

    @model_validator(mode="after")
    def _one_arrangement(self) -> RigFile:
        if (self.stereo is None) == (self.cameras is None):
            raise ValueError("give either a [stereo] table or [[cameras]]")
        return self


class ExactMount(Strict):
    """One camera of rig.json."""

    name: str = Field(min_length=1, max_length=40, pattern=r"^[A-Za-z0-9_-]+$")
    camera: dict[str, Any]
    T_head_camera: tuple[Row4, Row4, Row4, Row4]


class ExactRig(Strict):
    """rig.json of a sequence, as `Rig.to_json` writes it."""

    schema_: Literal[1] = Field(alias="schema")
    name: str = Field(max_length=80)
    frame_rate: Number = Field(default=30.0, gt=0, le=1000)
    mounts: tuple[ExactMount, ...] = Field(min_length=1, max_length=16)


def load_rig(path: str | Path) -> Rig:
    """Read a rig file: .json, or TOML with any other suffix. Raises FileError."""
    path = Path(path)
    _require_file(path)
    if path.suffix.lower() in FOREIGN_SUFFIXES:
        raise FileError(path, "holds cameras, not a rig: where they are on the head is not in it",
                        valid="a rig file; egocap rig convert makes one")  # fmt: skip
    data = read_json(path) if path.suffix.lower() == ".json" else read_toml(path)
    return parse_rig(data, path)


def load_rig_or_cameras(path: str | Path, size: tuple[int, int] | None = None) -> Rig | CameraSet:
    """A rig file as a rig, any other calibration as cameras without a head. Raises FileError.

    `size` (width, height) is for calibrations that do not hold the image size.
    """
    path = Path(path)
    _require_file(path)
    data = read_json(path) if path.suffix.lower() == ".json" else {}
    if path.suffix.lower() == ".toml" or {"mounts", "stereo", "cameras"} & data.keys():
        return load_rig(path)
    return read_cameras(path, size)


def _require_file(path: Path) -> None:
    """Raise FileError for what may be the name of a built-in rig."""
    if not path.suffix and not path.exists():
        raise FileError(path, "no such file", valid="a rig file, .toml or .json; the built-in rigs "
                        "are for egocap-sim, whose sequences hold theirs as rig.json")  # fmt: skip


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig file: .json, or TOML with any other suffix. Raises MachineError, FileError."""
    if path.suffix.lower() == ".json":
        rig.to_json(path)
    else:
        write_atomically(path, format_rig(rig))


def format_rig(rig: Rig) -> str:
    """A rig as TOML with exact numbers, which `load_rig` reads back."""
    lines = [f"name = {_toml_text(rig.name)}", f"frame_rate = {rig.frame_rate!r}"]
    for mount in rig.mounts:
        T = mount.T_head_camera
        lines += [
            "", "[[cameras]]", f"name = {_toml_text(mount.name)}",
            f"position = {T[:3, 3].tolist()}  # forward, left, up of the skull base, metres",
            f"rotation = {T[:3, :3].tolist()}", "", "[cameras.lens]",
        ]  # fmt: skip
        for key, value in mount.camera.to_dict().items():
            lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}")
    return "\n".join(lines) + "\n"


def _toml_text(text: str) -> str:
    """A text as a string of TOML, whose escapes are those of JSON."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def parse_rig(data: Any, where: str | Path) -> Rig:
    """Make a rig from a dictionary. Calibration paths are relative to the folder of `where`."""
    if isinstance(data, dict) and "mounts" in data:
        return _exact(data, where)
    if isinstance(data, dict) and not {"stereo", "cameras"} & data.keys():
        _refuse_camera(data, where)
    file = checked(RigFile, data, where)
    if file.stereo is not None:
        entries, keys = file.stereo.entries(), ("stereo", "stereo")
    else:
        entries = file.cameras or ()
        keys = tuple(f"cameras.{i}" for i in range(len(entries)))
    mounts = [
        Mount(entry.name, _camera(entry, file.lens, where, key), entry.T_head_camera())
        for entry, key in zip(entries, keys, strict=True)
    ]
    return _rig(file.name, mounts, file.frame_rate, where)


def _refuse_camera(data: dict[str, Any], where: str | Path) -> None:
    """Raise FileError if `data` is the calibration of a single camera."""
    try:
        camera_from_dict(data, where)
    except FileError:
        return
    raise FileError(where, "holds one camera, not a rig",
                    valid="a rig file in which a camera's `calibration` names it")  # fmt: skip


def _exact(data: dict[str, Any], where: str | Path) -> Rig:
    refuse_newer(data, SCHEMA, where, key="schema")
    file = checked(ExactRig, data, where)
    mounts = []
    for i, entry in enumerate(file.mounts):
        camera = camera_from_dict(entry.camera, where, f"mounts.{i}.camera")
        try:
            mounts.append(Mount(entry.name, camera, np.array(entry.T_head_camera)))
        except InputError as error:
            raise FileError(where, str(error), key=f"mounts.{i}.T_head_camera") from None
    return _rig(file.name, mounts, file.frame_rate, where)


def _camera(
    entry: CameraEntry, shared: dict[str, Any] | None, where: str | Path, key: str
) -> Camera:
    if entry.calibration is not None:
        key += ".calibration"
        camera = load_camera(Path(where).parent / entry.calibration)
    elif entry.lens is not None:
        key += ".lens"
        camera = camera_from_dict(entry.lens, where, key)
    elif shared is not None:
        key = "lens"
        camera = camera_from_dict(shared, where, key)
    else:
        raise FileError(where, "no lens", key=key, valid="lens, calibration, or the rig's [lens]")
    fov = degrees(2 * camera.max_angle)
    if fov > MAX_FOV:
        raise FileError(where, f"a field of view of {fov:.1f} degrees", key=key + ".fov",
                        valid=f"above 0, up to {MAX_FOV:g}")  # fmt: skip
    return camera


def _rig(name: str, mounts: list[Mount], frame_rate: float, where: str | Path) -> Rig:
    try:
        return Rig(name, tuple(mounts), frame_rate)
    except InputError as error:
        raise FileError(where, str(error), key="cameras") from None
