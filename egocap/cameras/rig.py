"""Rigs: cameras fixed to the head. Points and rays are in the head frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.lens import namespace
from egocap.errors import InputError
from egocap.files import write_json
from egocap.geometry import LEFT, UP, axis_angle, inverse

SCHEMA = 1  # of rig.json
FARTHEST_M = 1e4  # of a camera from the head, also in a file whose unit is millimetres

# Columns: the camera's x (right), y (down) and z (forward) in the head frame.
R_HEAD_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def camera_rotation(pitch: float, yaw: float = 0.0, roll: float = 0.0) -> Float[Array, "3 3"]:
    """R_head_camera from angles in degrees, as `egocap.cameras.rig_files` defines them."""
    optical_axis = np.array([0.0, 0.0, 1.0])
    turned = axis_angle(UP, radians(yaw)) @ axis_angle(LEFT, radians(pitch))
    return turned @ R_HEAD_AHEAD @ axis_angle(optical_axis, radians(roll))


@dataclass(frozen=True, eq=False)
class Mount:
    """One camera of a rig and its pose on the head."""

    name: str
    camera: Camera
    T_head_camera: Float[Array, "4 4"]  # metres

    def __post_init__(self) -> None:
        T = np.array(self.T_head_camera, float)
        if T.shape != (4, 4) or not np.isfinite(T).all():
            raise InputError(f"T_head_camera of '{self.name}' is not 4x4 and finite")
        if abs(T[:3, 3]).max() > FARTHEST_M:
            raise InputError(f"T_head_camera of '{self.name}': the camera is too far away",
                             valid=f"at most {FARTHEST_M:g} m along each axis")  # fmt: skip
        R = T[:3, :3]
        if (
            abs(R @ R.T - np.eye(3)).max() > 1e-6
            or np.linalg.det(R) < 0
            or any(T[3] != (0, 0, 0, 1))
        ):
            raise InputError(
                f"T_head_camera of '{self.name}' is not a rigid transform",
                valid="orthonormal right-handed rotation columns, last row 0 0 0 1",
            )
        T.setflags(write=False)
        object.__setattr__(self, "T_head_camera", T)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Mount)
            and (self.name, self.camera) == (other.name, other.camera)
            and np.array_equal(self.T_head_camera, other.T_head_camera)
        )


@dataclass(frozen=True)
class Rig:
    """Cameras rigid to the head. Axis V of every result runs over `mounts`."""

    name: str
    mounts: tuple[Mount, ...]
    frame_rate: float = 30.0  # Hz

    def __post_init__(self) -> None:
        object.__setattr__(self, "mounts", tuple(self.mounts))
        if not self.mounts or len(set(self.views)) != len(self.mounts):
            raise InputError(f"rig '{self.name}' has the views {list(self.views)}",
                             valid="one or more, each with its own name")  # fmt: skip

    def __repr__(self) -> str:
        mounts = ", ".join(f"{m.name}: {m.camera}" for m in self.mounts)
        return f"Rig({self.name!r}, {self.frame_rate:g} Hz, {mounts})"

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the views, e.g. ('left', 'right')."""
        return tuple(mount.name for mount in self.mounts)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Camera of each view."""
        return tuple(mount.camera for mount in self.mounts)

    @property
    def T_head_camera(self) -> Float[Array, "V 4 4"]:
        """Pose of each camera in the head frame."""
        return np.stack([mount.T_head_camera for mount in self.mounts])

    @property
    def T_camera_head(self) -> Float[Array, "V 4 4"]:
        """Maps points of the head frame into each camera's."""
        return inverse(self.T_head_camera)

    def project(self, points_head: Any) -> tuple[Any, Any]:
        """Pixels (V, ..., 2) and validity (V, ...) of points (..., 3) [m] in the head frame."""
        pairs = zip(self.mounts, self.T_camera_head, strict=True)
        return _stack([mount.camera.project(_move(T, points_head)) for mount, T in pairs])

    def project_jacobian(self, points_head: Any) -> tuple[Any, Any, Any]:
        """`project` with J (V, ..., 2, 3) [px/m], the derivative by the points."""
        results = []
        for mount, T in zip(self.mounts, self.T_camera_head, strict=True):
            pixels, J, valid = mount.camera.project_jacobian(_move(T, points_head))
            results.append((pixels, J @ _like(T[:3, :3], J), valid))
        return _stack(results)

    def rays(self, pixels: Any) -> tuple[Any, Any, Any]:
        """Rays of pixels (V, ..., 2): origins (V, 3) [m], unit directions (V, ..., 3), validity.

        Origins and directions are in the head frame.
        """
        results = []
        for mount, view in zip(self.mounts, pixels, strict=True):
            rays, valid = mount.camera.ray(view)
            results.append((rays @ _like(mount.T_head_camera[:3, :3].T, rays), valid))
        directions, valid = _stack(results)
        return _like(self.T_head_camera[:, :3, 3], directions), directions, valid

    def resized(self, width: int, height: int) -> Rig:
        """The same rig with every image scaled to width x height pixels."""
        mounts = (replace(m, camera=m.camera.resized(width, height)) for m in self.mounts)
        return replace(self, mounts=tuple(mounts))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form, read by `rig_files.parse_rig`."""
        return {
            "schema": SCHEMA, "name": self.name, "frame_rate": self.frame_rate,
            "mounts": [{"name": m.name, "camera": m.camera.to_dict(),
                        "T_head_camera": m.T_head_camera.tolist()} for m in self.mounts],
        }  # fmt: skip

    def to_json(self, path: str | Path) -> None:
        """Write rig.json with exact numbers. Raises as `egocap.files.disk_errors`."""
        write_json(Path(path), self.to_dict())


def _move(T_camera_head: Float[Array, "4 4"], points_head: Any) -> Any:
    points = points_head if namespace(points_head) is not np else np.asarray(points_head, float)
    R, t = T_camera_head[:3, :3], T_camera_head[:3, 3]
    return points @ _like(R.T, points) + _like(t, points)


def _like(values: Array, example: Any) -> Any:
    """Convert numpy values to the array type, precision and device of `example`."""
    return values if namespace(example) is np else example.new_tensor(values.tolist())


def _stack(results: list[tuple[Any, ...]]) -> tuple[Any, ...]:
    return tuple(namespace(column[0]).stack(column, 0) for column in zip(*results, strict=True))
