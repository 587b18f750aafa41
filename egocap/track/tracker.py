"""From detections in every view to a track of 37 joint angles."""

from __future__ import annotations

import logging
import time
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.errors import InputError
from egocap.results import Detections, Track
from egocap.rig import Rig
from egocap.skeleton import forward
from egocap.track.config import TrackerConfig
from egocap.track.observations import Observations, observe

if TYPE_CHECKING:
    from egocap.track.kernel import Model

log = logging.getLogger(__name__)


def track(
    detections: Detections,
    rig: Rig,
    proportions: Proportions,
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
) -> Track:
    """Track a person of known proportions from detections in all views of a rig.

    A causal pass predicts, solves and, where it is lost, searches every frame; then the chosen
    smoothing refines it. Frames without detections are carried by the motion around them.
    `energy` is each frame's own: detections, limits and pose prior. Raises InputError when there
    are no frames, the views do not match the rig, or the times do not increase.
    """
    times = np.asarray(detections.times, float)
    if len(times) == 0:
        raise InputError("no frames to track")
    if not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise InputError("the detections' times do not increase from frame to frame")
    from threadpoolctl import threadpool_limits

    from egocap.track import causal, kernel

    model = kernel.make_model(proportions, config)
    _compile(observe(detections, rig, proportions, config), model, config)

    # Matrices of 37 rows gain nothing from BLAS threads, which wait for each other when
    # the machine is busy.
    with threadpool_limits(1, user_api="blas"):
        started = time.perf_counter()
        observations = observe(detections, rig, proportions, config)
        angles, converged = _solve(observations, model, config)
        joints = forward(proportions, angles)
        seconds = time.perf_counter() - started

    return Track(
        times=times,
        angles=angles,
        joints_head=joints,
        energy=causal.frame_energies(angles, observations, model, config),
        converged=converged,
        detections_used=np.count_nonzero(observations.weights, axis=(1, 2)).astype(float),
        seconds_per_frame=seconds / len(times),
        config={"tracker": asdict(config), "detections": detections.source, "rig": rig.name},
    )


def _solve(
    observations: Observations, model: Model, config: TrackerConfig
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:
    from egocap.track import causal, smoothing

    if config.smoothing == "interval":
        angles, _ = causal.track_both_ways(observations, model, config)
        return smoothing.smooth_interval(angles, observations, model, config)
    angles, converged = causal.track_causally(observations, model, config)
    if config.smoothing == "gaussian":
        return smoothing.smooth_gaussian(angles, config.gaussian_frames), converged
    return angles, converged


def _compile(observations: Observations, model: Model, config: TrackerConfig) -> None:
    """Compile the kernels, or load them from the cache, outside the clock."""
    started = time.perf_counter()
    head = {
        name: getattr(observations, name)[:3] for name in ("times", "rays", "whiten", "weights")
    }
    _solve(replace(observations, **head), model, config)
    log.debug("kernels ready after %.1f s", time.perf_counter() - started)
