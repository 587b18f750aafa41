"""Pixels that move against the room: a limb, where its colour is that of the floor, too.

The optical flow of every pixel is compared with that of a room far away, which the rig's turn
explains, and with none at all, which explains what is fixed to the rig. What neither explains is
near and moves.

Source: Kroeger et al. 2016, "Fast Optical Flow using Dense Inverse Search"; motion segmentation
under a turning camera: e.g. Irani & Anandan 1998.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.image_model.image_rays import ImageRays, pixel_angle

LEAST = 1.0
"""Pixels against the room from which a pixel counts as moving, if the room itself lies still."""
OF_ROOM, OF_TURN = 3.0, 0.1
"""Times the median motion of pixels beside the body, and fraction of the rig's turn in pixels, that
are added to it: the room is not infinitely far, and fast pictures are compared less exactly."""
_FINEST, _PATCH, _STRIDE, _DESCENTS = 1, 8, 6, 12
"""Of the optical flow: halvings of the picture at which it ends, pixels of a patch and between two,
steps."""


class MovingPixels:
    """Compares pictures of a rig's views with those before. Not to be shared between threads."""

    def __init__(self, rig: Rig, rays: ImageRays) -> None:
        """`rig` has the size of the pictures; results are along `rays`."""
        import cv2

        self._rig, self._rays = rig, rays
        self._pixel = pixel_angle(rig.cameras[0])
        across, down = np.array([rig.cameras[0].width, rig.cameras[0].height]) / rays.size
        self._start = (rays.pixel + 0.5) * (across, down) - 0.5
        self._of_view = [np.flatnonzero(rays.view == v) for v in range(len(rig.mounts))]
        flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)  # pyright: ignore[reportAttributeAccessIssue]
        flow.setFinestScale(_FINEST)
        flow.setPatchSize(_PATCH)
        flow.setPatchStride(_STRIDE)
        flow.setGradientDescentIterations(_DESCENTS)
        flow.setVariationalRefinementIterations(0)
        self._flow = flow

    def measure(
        self, before: Sequence[UInt8[Array, "H W"]], after: Sequence[UInt8[Array, "H W"]],
        turn: Float[Array, "3 3"], beside: Bool[Array, "P"],
    ) -> Float[Array, "P"]:  # fmt: skip
        """How far every ray's pixel moved against room and rig, less what may be error, in pixels.

        `turn` is that of the room in the head frame between the grey pictures; `beside` are the
        rays beside the body.
        """
        import cv2

        moved = np.zeros(len(self._rays))
        for v, rays in enumerate(self._of_view):
            mount, here = self._rig.mounts[v], self._rays.direction[rays]
            flow = self._flow.calc(after[v], before[v], None)
            small = cv2.resize(flow, self._rays.size, interpolation=cv2.INTER_AREA)
            column, row = self._rays.pixel[rays].T
            seen, inside = mount.camera.ray(self._start[rays] + small[row, column])
            there = seen @ mount.T_head_camera[:3, :3].T
            off = np.minimum(
                np.linalg.norm(there - here @ turn, axis=1), np.linalg.norm(there - here, axis=1)
            )
            moved[rays] = np.where(inside, off, 0.0) / self._pixel
        angle = np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)) / self._pixel
        room = float(np.median(moved[beside])) if beside.any() else 0.0
        return np.maximum(moved - max(LEAST, OF_ROOM * room) - OF_TURN * angle, 0.0)
