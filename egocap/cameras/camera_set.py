"""Cameras as calibration programs leave them: relative to each other, not to a head."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.lens_fit import LensFit, exact
from egocap.cameras.rig import Mount, Rig, camera_rotation
from egocap.errors import InputError
from egocap.geometry import inverse, rigid

GUESS = "cameras 0.25 m before and 0.10 m above the skull base, looking 80 degrees down"
_GUESSED_CENTRE, _GUESSED_PITCH = (0.25, 0.0, 0.10), 80.0


@dataclass(frozen=True, eq=False)
class SetCamera:
    """One camera: its lens, with the error of fitting ours to it, and where it is."""

    name: str
    lens: LensFit
    T_first_camera: Float[Array, "4 4"] | None = None  # in the first camera's frame; None: unknown

    @property
    def camera(self) -> Camera:
        """The lens as ours."""
        return self.lens.camera


@dataclass(frozen=True, eq=False)
class CameraSet:
    """Cameras of one file."""

    cameras: tuple[SetCamera, ...]

    @classmethod
    def of(cls, rig: Rig) -> CameraSet:
        """The cameras of a rig, without the head."""
        first = inverse(rig.mounts[0].T_head_camera)
        return cls(
            tuple(SetCamera(m.name, exact(m.camera), first @ m.T_head_camera) for m in rig.mounts)
        )

    @property
    def worst_px(self) -> float:
        """Largest error of our lens models against the file's, pixels."""
        return max(c.lens.max_px for c in self.cameras)

    @property
    def rms_px(self) -> float:
        """Largest root mean square error of a lens, pixels."""
        return max(c.lens.rms_px for c in self.cameras)

    def rig(self, name: str, T_head_first: Float[Array, "4 4"] | None = None) -> Rig:
        """The cameras on a head, the first at `T_head_first`, or at a guess (`GUESS`).

        Raises InputError where the file does not say how the cameras lie to each other.
        """
        places = [c.T_first_camera for c in self.cameras]
        if any(T is None for T in places[1:]):
            raise InputError(
                "the file does not say how its cameras lie to each other",
                valid="a file with extrinsics, or a rig file that names one calibration per camera",
            )
        known = np.stack([np.eye(4), *(T for T in places[1:] if T is not None)])
        T = guessed_mount(known) if T_head_first is None else T_head_first
        mounts = [
            Mount(c.name, c.camera, T @ place) for c, place in zip(self.cameras, known, strict=True)
        ]
        return Rig(name, tuple(mounts))

    def named(self, names: Sequence[str]) -> CameraSet:
        """The same cameras with other names."""
        pairs = zip(self.cameras, names, strict=True)
        return CameraSet(tuple(replace(c, name=name) for c, name in pairs))


def guessed_mount(T_first_camera: Float[Array, "V 4 4"]) -> Float[Array, "4 4"]:
    """T_head_first that puts the cameras' mean where `GUESS` says, image right = head right.

    With several cameras the line between the outermost two runs left to right: as the pictures
    have it or, where the line is across their right (cameras mounted upright), first to last.
    """
    from scipy.spatial.transform import Rotation

    mean = Rotation.from_matrix(T_first_camera[:, :3, :3]).mean().as_matrix()
    centres = T_first_camera[:, :3, 3]
    axis = mean[:, 2]
    across = centres[None] - centres[:, None]
    across = across - (across @ axis)[..., None] * axis
    length = np.linalg.norm(across, axis=-1)
    if length.max() > 1e-3:
        right = across[np.unravel_index(length.argmax(), length.shape)] / length.max()
        right = -right if right @ mean[:, 0] < -0.5 else right
        mean = np.stack([right, np.cross(axis, right), axis], -1)
    T_first_mean = rigid(mean, centres.mean(0))
    guess = rigid(camera_rotation(_GUESSED_PITCH), np.array(_GUESSED_CENTRE))
    return guess @ inverse(T_first_mean)


def mount_at(
    position: Sequence[float], pitch: float, yaw: float = 0.0, roll: float = 0.0
) -> Float[Array, "4 4"]:
    """T_head_camera of a camera at a position [m] with angles [degrees], as in rig files."""

    return rigid(camera_rotation(pitch, yaw, roll), np.asarray(position, float))
