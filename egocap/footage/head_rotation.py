"""Rotation of the rig between consecutive pictures of one view, from the flow of the background.

Corners are tracked (Lucas-Kanade) in reduced grey pictures and cast to rays, whose relative motion
(`epipolar`) is free of the depth of the background. Points near the wearer's own body are left out,
and its other points are outliers.

Source: corners, Shi & Tomasi 1994.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount
from egocap.footage.epipolar import Motion, relative_motion

WIDTH = 320  # to which pictures are reduced, px
CORNERS = 220
FEWEST = 25  # points for an estimate
BODY_CONE = np.deg2rad(50.0)  # around straight down from the head: mostly the wearer
RIM = np.deg2rad(4.0)  # outermost part of the field of view, left out
_PIXELS = 0.04  # standard deviation of a tracked corner, px


class RotationMeter:
    """Measures the rotation of the rig over the pictures of one view, in order."""

    def __init__(self, mount: Mount) -> None:
        camera = mount.camera
        width = min(WIDTH, camera.width)
        self._size = width, max(round(camera.height * width / camera.width), 8)
        self._camera = camera.resized(*self._size)
        self._R = mount.T_head_camera[:3, :3]
        self._background, _ = background(self._camera, self._R)
        self._noise = _PIXELS * self._camera.max_angle / (0.5 * width)
        self._last: UInt8[Array, "h w"] | None = None
        self._motion: Motion | None = None

    def add(self, image: UInt8[Array, "H W 3"]) -> Float[Array, "3"]:
        """Rotation vector of the rig since the picture before [rad], in its own frame.

        Zero for the first picture; nan where it cannot be measured.
        """
        import cv2

        grey = cv2.cvtColor(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA),
                            cv2.COLOR_RGB2GRAY)  # fmt: skip
        last, self._last = self._last, grey
        if last is None:
            return np.zeros(3)
        before, after = self._tracked(last, grey)
        if len(before) < FEWEST:
            return np.full(3, np.nan)
        (r1, seen1), (r2, seen2) = self._camera.ray(before), self._camera.ray(after)
        seen = seen1 & seen2
        if seen.sum() < FEWEST:
            return np.full(3, np.nan)
        self._motion = relative_motion(
            r1[seen] @ self._R.T, r2[seen] @ self._R.T, self._noise, self._motion
        )
        return -_vector(self._motion.R)

    def _tracked(
        self, last: UInt8[Array, "h w"], grey: UInt8[Array, "h w"]
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
        """Corners of the background in the last picture, and where they are now."""
        import cv2

        corners = cv2.goodFeaturesToTrack(
            last, CORNERS, 0.005, 6, mask=self._background.astype(np.uint8), blockSize=5
        )
        if corners is None:
            return np.zeros((0, 2)), np.zeros((0, 2))
        moved, found, _ = cv2.calcOpticalFlowPyrLK(
            last, grey, corners, None, winSize=(13, 13), maxLevel=3  # pyright: ignore
        )  # fmt: skip
        good = found[:, 0] == 1
        return corners[good, 0].astype(float), moved[good, 0].astype(float)


def background(
    camera: Camera, R_head_camera: Float[Array, "3 3"]
) -> tuple[Bool[Array, "h w"], Float[Array, "h w 3"]]:
    """Pixels of a camera that mostly show the surroundings, and their rays in the head frame."""
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    rays, valid = camera.ray(pixels.astype(float))
    rim = np.arccos(np.clip(rays[..., 2], -1.0, 1.0)) > camera.max_angle - RIM
    rays = rays @ R_head_camera.T
    return valid & ~rim & (rays[..., 2] > -np.cos(BODY_CONE)), rays


def _vector(R: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """Rotation vector of a rotation by less than half a turn."""
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))
    return axis * (angle / sine) if sine > 1e-12 else axis
