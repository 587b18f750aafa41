"""Detections as the solver takes them: rays in the head frame, whitened by their accuracy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.errors import InputError
from egocap.geometry import unit
from egocap.results import Detections
from egocap.rig import Rig
from egocap.track.config import TrackerConfig

REFERENCE_WIDTH = 640
"""Image width in pixels to which `TrackerConfig.pixel_floor` refers."""


@dataclass(frozen=True, eq=False)
class Observations:
    """Rays to the detected joints. Missing ones have weight 0 and finite, meaningless values."""

    times: Float[Array, "T"]
    centres: Float[Array, "V 3"]  # cameras in the head frame, metres
    rays: Float[Array, "T V 18 3"]  # unit, head frame
    whiten: Float[Array, "T V 18 2 3"]  # direction across the ray -> standard deviations
    weights: Float[Array, "T V 18"]  # 0 for missing

    @property
    def reversed(self) -> Observations:
        """The same with time running backwards."""
        flipped = (np.ascontiguousarray(a[::-1]) for a in (self.rays, self.whiten, self.weights))
        return Observations(-self.times[::-1], self.centres, *flipped)


def observe(
    detections: Detections, rig: Rig, proportions: Proportions, config: TrackerConfig
) -> Observations:
    """Cast the detections into rays of the head frame.

    A pixel's accuracy becomes an angular covariance by the camera's local resolution; to it comes
    the scatter of true joints about the tracker's skeleton, seen from the rest pose's distance.
    Detections outside the image or lens, or with values that are not finite, count as missing.
    Raises InputError when the number of views does not match the rig.
    """
    T, V = detections.valid.shape[:2]
    if len(rig.mounts) != V:
        raise InputError(f"detections of {V} views with a rig of {len(rig.mounts)}")
    centres = np.array([m.T_head_camera[:3, 3] for m in rig.mounts])
    rays, whiten = np.zeros((T, V, 18, 3)), np.zeros((T, V, 18, 2, 3))
    usable = detections.valid & np.isfinite(detections.points).all(-1)
    usable &= np.isfinite(detections.sigma) & np.isfinite(detections.confidence)
    for v, mount in enumerate(rig.mounts):
        camera, R = mount.camera, mount.T_head_camera[:3, :3]
        pixels = np.where(usable[:, v, :, None], detections.points[:, v], camera.centre)
        ray, seen = camera.ray(pixels)
        _, J, _ = camera.project_jacobian(ray)
        floor = config.pixel_floor * camera.width / REFERENCE_WIDTH
        sigma = np.where(usable[:, v], np.maximum(detections.sigma[:, v], floor), floor)
        distance = np.linalg.norm(proportions.rest_joints - centres[v], axis=-1)
        model = config.model_error_m / np.maximum(distance, 0.05)
        whiten[:, v] = _whitener(ray, J, sigma, model) @ R.T
        rays[:, v] = ray @ R.T
        usable[:, v] &= seen
    weights = np.where(usable, config.lambda_detection * detections.confidence, 0.0)
    return Observations(np.asarray(detections.times, float), centres, rays, whiten, weights)


def _whitener(
    ray: Float[Array, "T 18 3"],
    J: Float[Array, "T 18 2 3"],
    sigma: Float[Array, "T 18"],
    model: Float[Array, "18"],
) -> Float[Array, "T 18 2 3"]:
    """Maps W with |W d| the distance of a direction d from the ray in standard deviations."""
    tangent = tangent_basis(ray)
    to_angle = np.linalg.inv(J @ np.swapaxes(tangent, -1, -2)) * sigma[..., None, None]
    covariance = to_angle @ np.swapaxes(to_angle, -1, -2)
    covariance = covariance + np.square(model)[:, None, None] * np.eye(2)
    # With inv(covariance) = L L^T, |L^T x| is x in standard deviations.
    L = np.linalg.cholesky(np.linalg.inv(covariance))
    return np.swapaxes(L, -1, -2) @ tangent


def tangent_basis(rays: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2 3"]:
    """Two unit vectors across each unit ray and each other."""
    helper = np.eye(3)[np.argmin(np.abs(rays), axis=-1)]
    first = unit(np.cross(rays, helper))
    return np.stack([first, np.cross(rays, first)], -2)
