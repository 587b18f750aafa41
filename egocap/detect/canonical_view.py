"""Canonical views: images of any camera of any rig, resampled to the detector's input view.

A canonical view is a fisheye image r = f sin(k theta) / k about an axis fixed in the head frame:
below the camera, a little behind and towards the middle of the body, with the head's forward
direction up. A camera near the face sees the body below and ahead of it, not behind: its axis
points farther forward (`near_pitch_deg`). Cameras on the head's right side are mirrored. So the
network's input is independent of lens, mounting angle and side, but not of the camera's position.
Magnification is largest in the middle, where the legs are smallest and pixels are worth most. It
is larger for a camera on a boom (`boom_focal`), which has the arms below it, not beside it.
Source: mirroring, EgoCap paper, section 4.3.1; larger than in training, Touvron et al. 2019,
"Fixing the train-test resolution discrepancy".
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import cos, isfinite, pi, radians, sin
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import MIRROR
from egocap.cameras.rig import Mount
from egocap.errors import InputError

LARGEST_SIDE = 2048  # pixels
_SHRINK_ABOVE = 2.0  # camera pixels per canonical pixel; above, images are reduced first
_FACE_TO_ARM_M = (0.14, 0.26)  # camera's distance in front of the skull base
_ARM_TO_BOOM_M = (0.20, 0.30)
_PIXEL_EDGES = np.array([[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5]])  # +x, +y, -x, -y
_MIRROR_Y = np.array([1.0, -1.0, 1.0])  # of the head frame


@dataclass(frozen=True)
class ViewSpec:
    """Size and projection of the canonical view. Raises InputError for values out of range."""

    width: int = 288  # pixels
    height: int = 256
    focal: float = 137.0  # pixels per radian on the axis
    compression: float = 0.95  # k of r = focal sin(k theta) / k; 0 is the equidistant lens
    pitch_deg: float = 105.0  # of the axis, below the head's forward direction
    toe_in_deg: float = 8.0  # of the axis, towards the body's middle plane
    near_pitch_deg: float | None = None  # `pitch_deg` of cameras near the face; None: the same
    boom_focal: float | None = None  # `focal` of cameras on booms; None: the same

    def __post_init__(self) -> None:
        sides = (self.width, self.height)
        if not all(isinstance(n, int) and 8 <= n <= LARGEST_SIDE for n in sides):
            raise InputError(f"canonical view of {sides[0]!r:.40} x {sides[1]!r:.40}",
                             valid=f"8 to {LARGEST_SIDE}")  # fmt: skip
        angles = (self.pitch_deg, self.toe_in_deg, self.near_pitch_deg or 0.0)
        focals = (self.focal, self.focal if self.boom_focal is None else self.boom_focal)
        if not all(isfinite(value) for value in (*focals, *angles)):
            raise InputError("canonical view with values that are not finite")
        if not (min(focals) > 0.0 and 0.0 <= self.compression <= 1.0):
            raise InputError(
                f"canonical view with focal {min(focals)}, compression {self.compression}",
                valid="focal above 0, compression 0 to 1",
            )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form: the fields."""
        return asdict(self)

    def mounted(self, forward_m: float) -> ViewSpec:
        """The view of a camera `forward_m` in front of the skull base.

        Its pitch changes linearly from `near_pitch_deg` at the face to `pitch_deg` at 0.26 m, its
        focal length from `focal` at 0.20 m to `boom_focal` at 0.30 m.
        """
        pitch, focal = self.pitch_deg, self.focal
        if self.near_pitch_deg is not None:
            pitch = float(np.interp(forward_m, _FACE_TO_ARM_M, (self.near_pitch_deg, pitch)))
        if self.boom_focal is not None:
            focal = float(np.interp(forward_m, _ARM_TO_BOOM_M, (focal, self.boom_focal)))
        return replace(self, pitch_deg=pitch, focal=focal, near_pitch_deg=None, boom_focal=None)

    @cached_property
    def axes(self) -> Float[Array, "3 3"]:
        """Rows: right, down and forward of the view of a left camera, in the head frame."""
        pitch, toe = radians(self.pitch_deg), radians(self.toe_in_deg)
        forward = np.array([cos(pitch), 0.0, -sin(pitch)])
        down = np.array([-sin(pitch), 0.0, -cos(pitch)])
        right = np.array([0.0, -1.0, 0.0])
        return np.stack(
            [right * cos(toe) - forward * sin(toe), down, forward * cos(toe) + right * sin(toe)]
        )

    def rays(self, points: Float[Array, "*n 2"]) -> tuple[Float[Array, "*n 3"], Bool[Array, "*n"]]:
        """Unit directions in the head frame (left camera) and validity of canonical points."""
        offset = (np.asarray(points, float) - self._centre) / self.focal
        radius = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), 1e-12)
        k = self.compression
        if k > 0.0:
            inside = k * radius < sin(min(k * pi, pi / 2))
            theta = np.arcsin(np.clip(k * radius, 0.0, 1.0)) / k
        else:
            inside, theta = radius < pi, radius
        xy = offset * (np.sin(theta) / radius)[..., None]
        return np.concatenate([xy, np.cos(theta)[..., None]], -1) @ self.axes, inside

    def points(self, rays: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 2"], Bool[Array, "*n"]]:
        """Canonical points and validity (inside the view) of directions in the head frame."""
        x, y, z = np.moveaxis(np.asarray(rays, float) @ self.axes.T, -1, 0)
        rho = np.maximum(np.hypot(x, y), 1e-12)
        theta = np.arctan2(rho, z)
        k = self.compression
        radius = np.sin(np.minimum(k * theta, pi / 2)) / k if k > 0.0 else theta
        scale = self.focal * radius / rho
        points = np.stack([x * scale, y * scale], -1) + self._centre
        inside = (points >= -0.5).all(-1) & (points <= np.array(self.size) - 0.5).all(-1)
        return points, inside & (k * theta < pi / 2)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.width, self.height

    @property
    def _centre(self) -> Float[Array, "2"]:
        return (np.array(self.size) - 1.0) / 2.0


class CanonicalView:
    """Mapping of one mounted camera's images and pixels to the canonical view and back."""

    def __init__(self, mount: Mount, spec: ViewSpec | None = None) -> None:
        self.spec = (spec or ViewSpec()).mounted(float(mount.T_head_camera[0, 3]))
        self.mirrored = bool(mount.T_head_camera[1, 3] < 0.0)
        self._mount = mount
        pixels, self.mask = self.to_camera(self._grid)
        self._shrink = max(1, int(self._typical_magnification() / _SHRINK_ABOVE + 0.5))
        self._maps = self._fixed_maps(pixels)

    def image(self, picture: UInt8[Array, "h w 3"], nearest: bool = False) -> UInt8[Array, "H W 3"]:
        """Resample an image to the canonical view; black outside the camera's field of view.

        `nearest` selects nearest-neighbour sampling, for label images, which may have one channel
        (h, w). Raises InputError for an image whose size is not the camera's.
        """
        import cv2

        camera = self._mount.camera
        if picture.shape[:2] != (camera.height, camera.width) or picture.dtype != np.uint8:
            raise InputError(
                f"a picture of shape {picture.shape}, {picture.dtype}, for the view "
                f"'{self._mount.name}'",
                valid=f"({camera.height}, {camera.width}, 3), uint8",
            )
        if nearest:
            rows, columns, inside = self._nearest_pixels
            found = np.zeros((*self.mask.shape, *picture.shape[2:]), np.uint8)
            found[inside] = picture[rows, columns]
            return found
        if self._shrink > 1:
            picture = cv2.resize(picture, self._shrunk_size, interpolation=cv2.INTER_AREA)
        return cv2.remap(picture, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)

    def to_view(self, pixels: Float[Array, "*n 2"]) -> tuple[Any, Any]:
        """Canonical points (..., 2) and validity of the camera's pixels (..., 2).

        Valid: within the camera's field of view and the canonical view.
        """
        rays, seen = self._mount.camera.ray(np.asarray(pixels, float))
        points, inside = self.spec.points(self._turned(rays @ self._mount.T_head_camera[:3, :3].T))
        return points, seen & inside

    def to_camera(self, points: Float[Array, "*n 2"]) -> tuple[Any, Any]:
        """The camera's pixels (..., 2) and validity of canonical points (..., 2).

        Inverse of `to_view`. Valid: within the canonical lens and the camera's field of view.
        """
        rays, defined = self.spec.rays(points)
        pixels, seen = self._mount.camera.project(
            self._turned(rays) @ self._mount.T_head_camera[:3, :3]
        )
        return pixels, seen & defined

    def magnification(self, points: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
        """Camera pixels per canonical pixel: the root of the area ratio at canonical points."""
        around, _ = self.to_camera(np.asarray(points, float)[..., None, :] + _PIXEL_EDGES)
        x, y = np.moveaxis(around[..., :2, :] - around[..., 2:, :], -2, 0)
        return np.sqrt(np.abs(x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]))

    def labels(self, values: Array, axis: int) -> Array:
        """Swap left and right labels along `axis` if the view is mirrored; self-inverse."""
        return np.take(values, MIRROR, axis) if self.mirrored else values

    def _turned(self, rays: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        return rays * _MIRROR_Y if self.mirrored else rays

    def _typical_magnification(self) -> float:
        v, u = np.mgrid[0 : self.spec.height : 8, 0 : self.spec.width : 8]
        points = np.stack([u, v], -1)
        seen = self.to_camera(points)[1]
        return float(np.median(self.magnification(points)[seen])) if seen.any() else 1.0

    @property
    def _grid(self) -> Float[Array, "H W 2"]:
        v, u = np.mgrid[: self.spec.height, : self.spec.width]
        return np.stack([u, v], -1)

    @cached_property
    def _nearest_pixels(self) -> tuple[Array, Array, Bool[Array, "H W"]]:
        """Row and column of the pixel nearest to each canonical one, where there is one."""
        camera = self._mount.camera
        pixels = np.where(self.mask[..., None], self.to_camera(self._grid)[0], -9.0)
        u, v = np.moveaxis(np.rint(pixels).astype(int), -1, 0)
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        return v[inside], u[inside], inside

    @property
    def _shrunk_size(self) -> tuple[int, int]:
        camera, s = self._mount.camera, self._shrink
        return max(1, round(camera.width / s)), max(1, round(camera.height / s))

    def _fixed_maps(self, pixels: Float[Array, "H W 2"]) -> tuple[Array, Array]:
        import cv2

        camera = self._mount.camera
        scale = np.array(self._shrunk_size) / (camera.width, camera.height)
        at = ((pixels + 0.5) * scale - 0.5).astype(np.float32)
        at[~self.mask] = -9.0  # outside: black border
        return cv2.convertMaps(at[..., 0].copy(), at[..., 1].copy(), cv2.CV_16SC2)
