"""Detections of one frame for the density: pixels, and whitening matrices of their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.observations import REFERENCE_WIDTH
from egocap.posterior.config import PosteriorConfig


@dataclass(frozen=True, eq=False)
class Measurement:
    """One frame. Missing detections have weight 0 and finite, meaningless values."""

    pixels: Float[Array, "V 18 2"]
    whiten: Float[Array, "V 18 2 2"]  # pixels off -> standard deviations
    weights: Float[Array, "V 18"]  # 0 for missing, else 1
    notes: tuple[str, ...]  # warnings about the result

    @property
    def count(self) -> int:
        """Detections that are used."""
        return int(np.count_nonzero(self.weights))


def check_frame(detections: Detections, frame: int, rig: Rig) -> None:
    """Raise InputError unless there is such a frame and the views match the rig."""
    frames, views = detections.valid.shape[:2]
    if not 0 <= frame < frames:
        raise InputError(f"no frame {frame} in the detections", valid=f"0 to {frames - 1}")
    if views != len(rig.mounts):
        raise InputError(f"detections of {views} views with a rig of {len(rig.mounts)}")


def measure(
    detections: Detections, frame: int, rig: Rig, proportions: Proportions, config: PosteriorConfig
) -> Measurement:
    """Gather one frame's detections.

    The standard deviation is the stated one, at least the floor, or the default where none is
    stated (zero or not a number). The skeleton's model error, at the rest pose's distance,
    is added. Raises InputError for a frame or views that do not exist.
    """
    check_frame(detections, frame, rig)
    points, sigma = detections.points[frame], np.asarray(detections.sigma[frame], float)
    confidence = detections.confidence[frame]
    usable = detections.valid[frame] & np.isfinite(points).all(-1) & np.isfinite(confidence)
    usable &= confidence >= config.least_confidence
    stated = np.isfinite(sigma) & (sigma > 0.0)
    pixels, whiten = np.zeros(points.shape), np.zeros((*points.shape, 2))
    for v, mount in enumerate(rig.mounts):
        camera, unit_px = mount.camera, mount.camera.width / REFERENCE_WIDTH
        pixels[v] = np.where(usable[v, :, None], points[v], camera.centre)
        spread = np.where(stated[v], np.maximum(sigma[v], config.pixel_floor * unit_px),
                          config.default_sigma * unit_px)  # fmt: skip
        ray, _ = camera.ray(pixels[v])
        _, J, _ = camera.project_jacobian(ray)  # pixels per metre at a distance of a metre
        distance = np.linalg.norm(proportions.rest_joints - mount.T_head_camera[:3, 3], axis=-1)
        scatter = J * (config.model_error_m / np.maximum(distance, 0.05))[:, None, None]
        covariance = scatter @ np.swapaxes(scatter, -1, -2)
        covariance = covariance + np.square(spread)[:, None, None] * np.eye(2)
        whiten[v] = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), -1, -2)
    return Measurement(pixels, whiten, usable.astype(float), _notes(usable, stated, config))


def _notes(usable: Array, stated: Array, config: PosteriorConfig) -> tuple[str, ...]:
    notes = []
    if not usable.any():
        notes.append("no detections in this frame: what follows is the prior")
    if assumed := int((usable & ~stated).sum()):
        notes.append(f"{assumed} of {int(usable.sum())} detections state no spread: "
                     f"{config.default_sigma:g} px at {REFERENCE_WIDTH} px assumed")  # fmt: skip
    return tuple(notes)
