"""The motion network's prediction for a solved motion."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import EVALUATED, LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.data.head_pose import HeadPoses
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.motion_network import correct_track, network_precision
from egocap.pose.motion_prior import MotionPrediction
from egocap.pose.observations import Observations
from egocap.track.uncertainty import interval_covariances, joint_deviations

INDEPENDENT = 0.1
"""Fraction of the motion prior's information that covariances count, as its errors persist from
frame to frame. Chosen so that regions of 80 and 95 % hold on validation clips; those of 50 % hold
61 %."""
_GUESSED = [i for i in EVALUATED if i != LABEL_INDEX["neck"]]
"""Labels that every detection of the wearer has: those of the limbs."""


def undetected(observations: Observations) -> Bool[Array, "T"]:
    """Frames in which a joint has no detection at all, of which the network was not told."""
    detected = np.any(observations.weights[:, :, _GUESSED] > 0.0, axis=1)
    return np.any(~detected, axis=1)


def predict_by_network(
    angles: Float[Array, "T 37"], observations: Observations, proportions: Proportions,
    model: Model, config: TrackerConfig, heads: HeadPoses | None,
) -> MotionPrediction:  # fmt: skip
    """What the motion network makes of a motion without a motion prior, and of the head's."""
    covariances = interval_covariances(angles, observations, model, config)
    std = joint_deviations(proportions, angles, covariances, config.model_error_m)
    mean, spread = correct_track(observations.times, angles, std, proportions, heads)
    return MotionPrediction(mean, network_precision(spread))
