"""The views of a rig at working size: rays, their derivatives, and when pixels are exposed.

A frame's pose is that at its time. A pixel of a late view, or of a rolling shutter's row, is
exposed `delay` seconds after it, when the head has moved by its twist: rotation [rad/s] and
translation [m/s] in the head frame.

Source: Hedborg et al. 2012, Rolling shutter bundle adjustment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.ray_kernel import Lens, cast, make_lens
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.geometry import exponential
from egocap.odometry.ray_kernel import sights_later

RIM = np.deg2rad(3.0)
"""Outermost part of the field of view, left out."""
_GRID = 8
"""Pixels between those whose rays are computed when a picture is turned."""


@dataclass(frozen=True, eq=False)
class Motion:
    """How the head moves at a frame, and how late the picture of each view was taken."""

    twist: Float[Array, "6"]  # rad/s and m/s, head frame
    late: Float[Array, "V"]  # s

    @classmethod
    def none(cls, views: int) -> Motion:
        """At rest, with pictures of one instant."""
        return cls(np.zeros(6), np.zeros(views))


@dataclass(frozen=True, eq=False)
class Views:
    """A rig whose pictures are at most `width` pixels wide, and when its views are exposed."""

    rig: Rig
    lag_s: tuple[float, ...] = ()  # of the middle row of each view behind the frame; empty: none
    readout_s: tuple[float, ...] = ()  # of each view, from the first row to the last; empty: none

    @classmethod
    def of(cls, rig: Rig, width: int) -> Views:
        """The working views of a rig. Raises InputError for a rig of one view."""
        if len(rig.mounts) < 2:
            raise InputError(f"rig '{rig.name}' has one view: the scale cannot be measured",
                             valid="two views or more, or head poses from elsewhere")  # fmt: skip
        camera = rig.cameras[0]
        scale = min(width / camera.width, 1.0)
        size = round(camera.width * scale), round(camera.height * scale)
        if all((c.width, c.height) == (camera.width, camera.height) for c in rig.cameras):
            return cls(rig.resized(*size))
        raise InputError(f"rig '{rig.name}' has views of different sizes", valid="equal sizes")

    def __len__(self) -> int:
        return len(self.rig.mounts)

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return self.rig.cameras

    @cached_property
    def centres(self) -> Float[Array, "V 3"]:
        """Camera centres in the head frame, metres."""
        return np.ascontiguousarray(self.rig.T_head_camera[:, :3, 3])

    @cached_property
    def R_head_camera(self) -> Float[Array, "V 3 3"]:
        return self.rig.T_head_camera[:, :3, :3]

    @cached_property
    def lenses(self) -> tuple[Lens, ...]:
        """The cameras as compiled code takes them."""
        return tuple(make_lens(camera) for camera in self.cameras)

    @cached_property
    def T_camera_head(self) -> Float[Array, "V 4 4"]:
        return self.rig.T_camera_head

    @cached_property
    def lens_masks(self) -> tuple[UInt8[Array, "H W"], ...]:
        """255 where a pixel is inside the field of view, the rim left out."""
        found = []
        for camera in self.cameras:
            pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
            rays, valid = camera.ray(pixels.astype(float))
            inner = np.arccos(np.clip(rays[..., 2], -1.0, 1.0)) < camera.max_angle - RIM
            found.append(np.where(valid & inner, 255, 0).astype(np.uint8))
        return tuple(found)

    @cached_property
    def partners(self) -> tuple[tuple[int, ...], ...]:
        """For every view, the others by the overlap of their optical axes."""
        axes = self.R_head_camera[:, :, 2]
        order = np.argsort(-(axes @ axes.T), axis=1, kind="stable")
        return tuple(tuple(int(u) for u in row if u != v) for v, row in enumerate(order))

    def rays(
        self, view: int, pixels: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n 3"], Bool[Array, "n"]]:
        """Unit rays in the head frame of a view's pixels, and whether they are in its field."""
        rays, _, valid = cast(self.lenses[view], pixels)
        return rays @ self.R_head_camera[view].T, valid

    def rays_and_derivative(
        self, view: int, pixels: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 2"], Float[Array, "n"], Bool[Array, "n"]]:
        """`rays` with the two of `ray_derivative` before the validity."""
        rays, J, valid = cast(self.lenses[view], pixels)
        to_camera = self.R_head_camera[view].T
        return rays @ to_camera, *_by_pixel(J @ to_camera), valid

    def project(
        self, view: int, points_head: Float[Array, "*n 3"]
    ) -> tuple[Float[Array, "*n 2"], Bool[Array, "*n"]]:
        """Pixels of points in the head frame."""
        T = self.T_camera_head[view]
        return self.cameras[view].project(points_head @ T[:3, :3].T + T[:3, 3])

    def delay(self, view: int, pixels: Float[Array, "n 2"], motion: Motion) -> Float[Array, "n"]:
        """Seconds from the frame's time to the exposure of a view's pixels."""
        row = np.clip(pixels[:, 1] / (self.cameras[view].height - 1) - 0.5, -0.5, 0.5)
        lag = motion.late[view] + (self.lag_s[view] if self.lag_s else 0.0)
        return lag + (self.readout_s[view] if self.readout_s else 0.0) * row

    def sights(
        self, view: Int[Array, "n"], rays: Float[Array, "n 3"], delay: Float[Array, "n"],
        twist: Float[Array, "*n 6"],
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:  # fmt: skip
        """Camera centres [m] and rays, seen `delay` after a frame, in its own head frame.

        `twist`: that of the frame, or one for each ray of several frames.
        """
        centres = self.centres[view]
        if not delay.any():
            return centres, rays
        return sights_later(centres, rays, delay, np.broadcast_to(twist, (len(rays), 6)))

    def later(
        self, points_head: Float[Array, "n *m 3"], delay: Float[Array, "n"], motion: Motion
    ) -> Float[Array, "n *m 3"]:  # fmt: skip
        """Points in the head frame `delay` after a frame, from those in the frame's."""
        if not delay.any():
            return points_head
        moved = (delay[:, None] * motion.twist[3:]).reshape(-1, *(1,) * (points_head.ndim - 2), 3)
        R = exponential(delay[:, None] * motion.twist[:3])
        return np.einsum("n...j,nji->n...i", points_head - moved, R)

    def project_moving(
        self, view: int, points_head: Float[Array, "n 3"], motion: Motion
    ) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:
        """`project` with the rows' times."""
        pixels, valid = self.project(view, points_head)
        delay = self.delay(view, pixels, motion)
        if not delay.any():
            return pixels, valid
        return self.project(view, self.later(points_head, delay, motion))

    def turned(
        self, view: int, image: UInt8[Array, "H W"], turn: Float[Array, "3 3"]
    ) -> UInt8[Array, "H W"]:
        """A picture as the view would have seen it after the head turned, without parallax.

        `turn` maps directions in the turned head's frame to those in the picture's. To a tenth of a
        pixel; black where the picture does not reach.
        """
        import cv2

        height, width = image.shape
        shape = _grid_size(height), _grid_size(width)
        found, _ = self.project_directions(view, self._grid_rays[view] @ turn.T)
        u, v = np.meshgrid(np.arange(width) / _GRID, np.arange(height) / _GRID)
        grid = found.reshape(*shape, 2).astype(np.float32)
        at = cv2.remap(grid, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
        return cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR)

    def project_directions(
        self, view: int, rays: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 2"], Bool[Array, "n"]]:
        """Pixels of rays in the head frame, as `rays` gives them."""
        return self.cameras[view].project(rays @ self.R_head_camera[view])

    @cached_property
    def _grid_rays(self) -> tuple[Float[Array, "n 3"], ...]:
        """Rays of every `_GRID`th pixel of each view, row by row, to beyond the picture's edge."""
        found = []
        for v, camera in enumerate(self.cameras):
            u = _GRID * np.arange(_grid_size(camera.width))
            w = _GRID * np.arange(_grid_size(camera.height))
            found.append(self.rays(v, np.stack(np.meshgrid(u, w), -1).reshape(-1, 2))[0])
        return tuple(found)

    def project_jacobian(
        self, view: int, points_head: Float[Array, "*n 3"]
    ) -> tuple[Float[Array, "*n 2"], Float[Array, "*n 2 3"], Bool[Array, "*n"]]:
        """`project` and its derivative by the point in the head frame."""
        T = self.T_camera_head[view]
        pixels, J, valid = self.cameras[view].project_jacobian(points_head @ T[:3, :3].T + T[:3, 3])
        return pixels, J @ T[:3, :3], valid

    def ray_derivative(
        self, view: int, rays: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3 2"], Float[Array, "n"]]:
        """Derivative of unit rays by their pixels [1/px], and pixels per radian (mean)."""
        _, J, _ = self.project_jacobian(view, rays + self.centres[view])
        return _by_pixel(J)


def _by_pixel(
    J: Float[Array, "n 2 3"],
) -> tuple[Float[Array, "n 3 2"], Float[Array, "n"]]:
    """Derivative of unit rays by pixels from that of pixels by rays, and pixels per radian."""
    a, b, d = (np.einsum("ni,ni->n", J[:, i], J[:, k]) for i, k in ((0, 0), (0, 1), (1, 1)))
    determinant = a * d - b * b
    inverse = np.stack([d, -b, -b, a], 1).reshape(-1, 2, 2) / determinant[:, None, None]
    return J.transpose(0, 2, 1) @ inverse, determinant**0.25


def _grid_size(pixels: int) -> int:
    return -(-pixels // _GRID) + 1
