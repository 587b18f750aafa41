"""Bounds and tracked errors of one rig over a suite of motions.

The bound of a single frame is Bayesian: detections of one noise at one image size, of every visible
joint, and the pose prior. The tracker runs on detections simulated with the same visibility; its
errors stand beside the bound given the whole motion and the error that a frame's posterior expects.
Errors of visible joints are also given separately: occluded joints of a calm motion can have a
lower error than the bound, which averages over motions drawn from the prior.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import egocap
from egocap.body.labels import EVALUATED
from egocap.cameras.rig import Rig
from egocap_eval.rig_design.rig_report import Candidate, Tracked
from egocap_eval.rig_design.rig_suite import Motion, SuiteVisibility
from egocap_eval.rig_design.rig_sweep import SIZE

MODEL_ERROR_M = 0.0
"""Scatter of true joints about the skeleton: none, the tracker's fits these motions to 0.1 mm."""
POSTERIORS = 12
"""Frames of each motion whose posterior is computed."""
_JOINTS = list(EVALUATED)


def bound(
    measures: Mapping[str, float], rig: Rig, visibility: SuiteVisibility, sigma: float
) -> Candidate:
    """Visibility and Bayesian bound of one rig."""
    from egocap.posterior.information import (
        Noise,
        fisher_information,
        joint_covariance,
        prior_information,
        rms_mm,
    )

    noise = Noise(sigma, model_error_m=MODEL_ERROR_M)
    squared, seen_all = [], []
    for i, motion in enumerate(visibility.motions):
        seen = visibility.seen(rig, i)
        information = fisher_information(motion.angles, motion.proportions, rig, seen, noise)
        covariance = np.linalg.inv(information + prior_information(motion.angles))
        joints = joint_covariance(motion.angles, motion.proportions, covariance)
        squared.append(rms_mm(joints)[:, _JOINTS] ** 2)
        seen_all.append(seen[..., _JOINTS])
    each, seen = np.concatenate(squared), np.concatenate(seen_all)
    return Candidate(
        dict(measures), float(seen.any(1).mean()), float(seen.all(1).mean()), each.mean(1),
        np.sqrt(each.mean(0)),
    )  # fmt: skip


def track_errors(rig: Rig, visibility: SuiteVisibility, sigma: float, seed: int) -> Tracked:
    """Root mean squares [mm] over the suite: the bound given the whole motion, the error expected
    by a frame's Laplace posterior, its mode's error, and the tracker's."""
    from egocap.detect.synthetic import ProjectedJoints, SimulatedSource, simulate_detections
    from egocap.pose.config import TrackerConfig
    from egocap.posterior.information import Noise, fisher_information, smoothed_bound

    config, rng = TrackerConfig(), np.random.default_rng(seed)
    noise = Noise(sigma, model_error_m=MODEL_ERROR_M)
    names = ("smoothed", "smoothed_seen", "posterior", "mode", "tracked", "tracked_seen")
    totals: dict[str, list[Array]] = {f"{name}_mm": [] for name in names}
    frames = []
    for i, motion in enumerate(visibility.motions):
        seen = visibility.seen(rig, i)
        pixels = np.moveaxis(rig.project(motion.joints)[0], 0, 1)
        joints = ProjectedJoints(pixels, seen, seen, motion.times, SIZE)
        found = simulate_detections(joints, SimulatedSource(sigma), rng)
        result = egocap.Tracker(rig, motion.proportions, config).track(found)
        errors = _errors(result.joints_head, motion.joints)
        information = fisher_information(motion.angles, motion.proportions, rig, seen, noise)
        bounds = smoothed_bound(
            motion.angles, motion.proportions, motion.times, information, config
        )[:, _JOINTS]
        mine = seen[..., _JOINTS].any(axis=1)
        totals["tracked_mm"].append(errors.ravel())
        totals["tracked_seen_mm"].append(errors[mine])
        totals["smoothed_mm"].append(bounds.ravel())
        totals["smoothed_seen_mm"].append(bounds[mine])
        expected, error = _laplace(found, rig, motion, seed)
        totals["posterior_mm"].append(expected.ravel())
        totals["mode_mm"].append(error.ravel())
        frames.append((errors**2).mean(1))
    rms = {
        name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in totals.items()
    }
    return Tracked(rms, np.concatenate(frames))


def _laplace(
    found: Any, rig: Rig, motion: Motion, seed: int
) -> tuple[Float[Array, "B 17"], Float[Array, "B 17"]]:
    """Expected spread and error of the mode [mm] of some frames, each by itself."""
    from egocap.posterior.config import PosteriorConfig
    from egocap.posterior.laplace import find_modes
    from egocap.posterior.log_prob import make_log_posterior
    from egocap.posterior.sampler import laplace_joints

    config = PosteriorConfig(degrees=np.inf, model_error_m=MODEL_ERROR_M)
    expected, errors = [], []
    for t in np.linspace(0, len(motion.joints) - 1, POSTERIORS).astype(int):
        density = make_log_posterior(found, int(t), rig, motion.proportions, config)
        mode = find_modes(density, np.random.default_rng(seed))[0]
        spread = np.trace(laplace_joints(density, mode), axis1=1, axis2=2)
        expected.append(1e3 * np.sqrt(spread[_JOINTS]))
        errors.append(_errors(density.joints(mode.mean[None]), motion.joints[t : t + 1])[0])
    return np.array(expected), np.array(errors)


def _errors(joints: Float[Array, "T 18 3"], truth: Float[Array, "T 18 3"]) -> Float[Array, "T 17"]:
    return 1e3 * np.linalg.norm(joints - truth, axis=-1)[:, _JOINTS]
