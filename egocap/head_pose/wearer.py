"""Which pixels show the wearer: the tracked body's Gaussians as discs in every view."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.gaussians import RADIUS_SIGMAS, SKULL, GaussianBody
from egocap.body.kinematics import forward_kinematics, kinematic_tree
from egocap.body.proportions import Proportions
from egocap.body.skeleton import JOINTS
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.odometry.views import Views

MARGIN = 0.05  # m around the body: clothes, and the track's error


class WearerMasks:
    """Masks of a tracked wearer in the working pictures of a rig."""

    def __init__(self, track: Track, views: Views) -> None:
        if track.offsets is None:
            raise InputError("the track has no bone lengths", valid="a track of this release")
        self._track, self._views = track, views
        self._body = GaussianBody.from_proportions(Proportions(track.offsets))
        self._tree = kinematic_tree(self._body.proportions)
        self._step = float(np.median(np.diff(track.times))) if len(track.times) > 1 else 1.0

    def at(self, time: float) -> tuple[Bool[Array, "H W"] | None, ...]:
        """The wearer's pixels in every view at a time [s]; None where the track has no frame."""
        import cv2

        i = int(np.abs(self._track.times - time).argmin())
        if abs(self._track.times[i] - time) > 0.6 * self._step:
            return (None,) * len(self._views)
        centres = self._centres(self._track.angles[i])
        masks: list[Bool[Array, "H W"]] = []
        for v, camera in enumerate(self._views.cameras):
            mask = np.zeros((camera.height, camera.width), np.uint8)
            for (u, w), radius in zip(*self._discs(v, centres), strict=True):
                cv2.circle(mask, (round(u), round(w)), int(np.ceil(radius)), 1, -1)
            masks.append(mask > 0)
        return tuple(masks)

    def _centres(self, angles: Float[Array, "37"]) -> Float[Array, "G 3"]:
        """Centres of the Gaussians in the head frame."""
        points, axes = np.empty((len(self._tree.parents), 3)), np.empty((len(angles), 3))
        R = np.empty((len(JOINTS), 3, 3))
        forward_kinematics(self._tree, np.asarray(angles, float), points, axes, R)
        joint, offset = self._body.joint, self._body.offset
        on_joint = points[joint] + np.einsum("gij,gj->gi", R[joint], offset)
        return np.where((joint == SKULL)[:, None], offset, on_joint)

    def _discs(
        self, view: int, centres: Float[Array, "G 3"]
    ) -> tuple[Float[Array, "G 2"], Float[Array, "G"]]:
        """Pixel of every Gaussian and its radius in pixels."""
        away = centres - self._views.centres[view]
        distance = np.linalg.norm(away, axis=1)
        _, density = self._views.ray_derivative(view, away / distance[:, None])
        angle = np.arctan2(RADIUS_SIGMAS * self._body.sigma + MARGIN, distance)
        camera = self._views.cameras[view]
        pixels, _ = self._views.project(view, centres)
        pixels = np.clip(pixels, -camera.width, 2 * camera.width)
        return pixels, np.minimum(density * angle, camera.width)
