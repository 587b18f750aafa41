"""Detections in, observations out: rays in the head frame, whitened by their standard deviations.

A detector's heat map may have several modes; `egocap.track.association` chooses among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.geometry import unit
from egocap.pose.config import TrackerConfig

REFERENCE_WIDTH = 640
"""Image width in pixels to which `TrackerConfig.pixel_floor` refers."""
OPPOSITE = 1e-6
"""1 + cos of the angle to a ray up to which a direction is opposite, and metres to the centre of a
camera up to which a joint has no direction."""
EVEN_SIGMA = 4.0
"""Standard deviation of every detection, pixels at that width, without `use_detector_sigma`: about
the mean of the shipped detector's."""


class Rays(NamedTuple):
    """The arrays of `Observations` for the kernels: of one frame, or of T frames."""

    centres: Float[Array, "V 3"]
    rays: Float[Array, "*T V 18 3"]
    whiten: Float[Array, "*T V 18 2 3"]
    weights: Float[Array, "*T V 18"]


@dataclass(frozen=True, eq=False)
class Observations:
    """Rays to the detected joints. Missing ones have weight 0 and finite, meaningless values."""

    times: Float[Array, "T"]
    centres: Float[Array, "V 3"]  # cameras in the head frame, metres
    rays: Float[Array, "T V 18 3"]  # unit, head frame
    whiten: Float[Array, "T V 18 2 3"]  # direction across the ray -> standard deviations
    weights: Float[Array, "T V 18"]  # 0 for missing
    modes: Modes | None = None  # other modes; None: there are none

    @property
    def arrays(self) -> Rays:
        """All frames for the kernels."""
        return Rays(self.centres, self.rays, self.whiten, self.weights)

    def frame(self, t: int) -> Rays:
        """One frame for the kernels; its arrays are views."""
        return Rays(self.centres, self.rays[t], self.whiten[t], self.weights[t])

    @property
    def reversed(self) -> Observations:
        """The same with time running backwards."""
        flipped = self[::-1]
        return replace(flipped, times=-flipped.times)

    def weighted(self, factor: float) -> Observations:
        """The same with weights, those of modes too, times a factor."""
        modes = self.modes and replace(self.modes, weights=self.modes.weights * factor)
        return replace(self, weights=self.weights * factor, modes=modes)

    def __getitem__(self, frames: slice) -> Observations:
        """Some of the frames, in a copy."""
        modes = None if self.modes is None else self.modes[frames]
        return replace(
            self, times=self.times[frames], rays=np.array(self.rays[frames]),
            whiten=self.whiten[frames].copy(), weights=self.weights[frames].copy(), modes=modes,
        )  # fmt: skip


def joined(frames: Sequence[Observations]) -> Observations:
    """Frames of the same cameras one after another, without modes."""
    times, rays, whiten, weights = (
        np.concatenate([getattr(frame, name) for frame in frames])
        for name in ("times", "rays", "whiten", "weights")
    )
    return Observations(times, frames[0].centres, rays, whiten, weights)


@dataclass(frozen=True, eq=False)
class Modes:
    """K other modes of every joint, likeliest first."""

    rays: Float[Array, "T K V 18 3"]
    whiten: Float[Array, "T K V 18 2 3"]
    weights: Float[Array, "T K V 18"]  # 0 where there is no such mode
    cost: Float[Array, "T K V 18"]  # energy added by its lower likelihood, 0 or more

    def __getitem__(self, frames: slice) -> Modes:
        """Some of the frames, in a copy."""
        parts = (self.rays, self.whiten, self.weights, self.cost)
        return Modes(*(np.ascontiguousarray(a[frames]) for a in parts))


def observe(
    detections: Detections, rig: Rig, proportions: Proportions, config: TrackerConfig
) -> Observations:
    """Cast the detections into rays of the head frame.

    A standard deviation in pixels becomes an angular covariance by the camera's local resolution;
    the skeleton's model error, at the rest pose's distance, is added.
    Detections outside the image or lens, or with values that are not finite, count as missing.
    Raises InputError when the number of views does not match the rig.
    """
    V = detections.valid.shape[1]
    if len(rig.mounts) != V:
        raise InputError(f"detections of {V} views with a rig of {len(rig.mounts)}")
    centres = np.array([m.T_head_camera[:3, 3] for m in rig.mounts])
    usable = detections.valid & np.isfinite(detections.sigma) & np.isfinite(detections.confidence)
    caster = _Caster(detections, usable, rig, proportions, config)
    places, cost = detections.points[:, None], None
    if config.use_modes and detections.modes is not None and detections.mode_weights is not None:
        others, cost = _other_modes(detections.modes, detections.mode_weights)
        places = np.concatenate([places, others], axis=1)
    rays, whiten, weights = caster.cast(places)
    modes = None
    if cost is not None and cost.shape[1]:
        modes = Modes(*_contiguous(rays[:, 1:], whiten[:, 1:], weights[:, 1:]), cost)
    first = _contiguous(rays[:, 0], whiten[:, 0], weights[:, 0])
    return Observations(np.asarray(detections.times, float), centres, *first, modes)


def _contiguous(rays: Array, whiten: Array, weights: Array) -> tuple[Array, Array, Array]:
    """The same arrays as the kernels need them laid out."""
    return np.ascontiguousarray(rays), np.ascontiguousarray(whiten), np.ascontiguousarray(weights)


def _other_modes(
    places: Float[Array, "T V 18 K 2"], shares: Float[Array, "T V 18 K"]
) -> tuple[Float[Array, "T M V 18 2"], Float[Array, "T M V 18"]]:
    """Pixels of the modes after the first, nan where missing, and their cost.

    The cost is the log ratio of the first one's weight to theirs.
    """
    there = (shares > 0.0) & (shares[..., :1] > 0.0)
    most = [k for k in range(1, places.shape[3]) if there[..., k].any()]
    safe = np.where(there, shares, 1.0)
    cost = np.maximum(np.log(safe[..., :1] / safe[..., most]), 0.0)
    pixels = np.where(there[..., most, None], places[..., most, :], np.nan)
    return np.moveaxis(pixels, 3, 1), np.ascontiguousarray(np.moveaxis(cost, 3, 1))


@dataclass(frozen=True, eq=False)
class _Caster:
    """Casts pixels into whitened rays."""

    detections: Detections
    usable: Bool[Array, "T V 18"]
    rig: Rig
    proportions: Proportions
    config: TrackerConfig

    def cast(
        self, points: Float[Array, "T M V 18 2"]
    ) -> tuple[Float[Array, "T M V 18 3"], Float[Array, "T M V 18 2 3"], Float[Array, "T M V 18"]]:
        """Rays, whiteners and weights of pixels; missing where these are not finite."""
        from egocap.cameras.ray_kernel import cast, make_lens  # numba takes long to import
        from egocap.pose.whitening_kernel import whiten_rays

        found, config = self.detections, self.config
        rays, whiten = np.zeros((*points.shape[:4], 3)), np.zeros((*points.shape[:4], 2, 3))
        usable = self.usable[:, None] & np.isfinite(points).all(-1)
        for v, mount in enumerate(self.rig.mounts):
            camera, R = mount.camera, mount.T_head_camera[:3, :3]
            pixels = np.where(usable[:, :, v, :, None], points[:, :, v], camera.centre)
            ray, J, seen = cast(make_lens(camera), pixels)
            floor = config.pixel_floor * camera.width / REFERENCE_WIDTH
            even = EVEN_SIGMA * camera.width / REFERENCE_WIDTH
            stated = (
                found.sigma[:, None, v]
                if config.use_detector_sigma
                else np.full_like(found.sigma[:, None, v], even)
            )
            sigma = np.where(usable[:, :, v], np.maximum(stated, floor), floor)
            centre = mount.T_head_camera[:3, 3]
            distance = np.linalg.norm(self.proportions.rest_joints - centre, axis=-1)
            model = config.model_error_m / np.maximum(distance, 0.05)
            whiten_rays(ray, J, sigma, model, R, rays[:, :, v], whiten[:, :, v])
            usable[:, :, v] &= seen
        trust = config.occluded_weight + (1.0 - config.occluded_weight) * found.confidence
        return rays, whiten, np.where(usable, config.lambda_detection * trust[:, None], 0.0)


def tangent_basis(rays: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2 3"]:
    """Two unit vectors across each unit ray and each other."""
    helper = np.eye(3)[np.argmin(np.abs(rays), axis=-1)]
    first = unit(np.cross(rays, helper))
    return np.stack([first, np.cross(rays, first)], -2)
