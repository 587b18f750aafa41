"""The motion network's prediction for a solved motion."""

from __future__ import annotations

from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.data.head_pose import HeadPoses
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.motion_network import correct_track, network_precision
from egocap.pose.motion_prior import MotionPrediction
from egocap.pose.observations import Observations
from egocap.track.uncertainty import interval_covariances, joint_deviations


def predict_by_network(
    angles: Float[Array, "T 37"], observations: Observations, proportions: Proportions,
    model: Model, config: TrackerConfig, heads: HeadPoses | None,
) -> MotionPrediction:  # fmt: skip
    """What the motion network makes of a motion without a motion prior, and of the head's."""
    covariances = interval_covariances(angles, observations, model, config)
    std = joint_deviations(proportions, angles, covariances, config.model_error_m)
    mean, spread = correct_track(observations.times, angles, std, proportions, heads)
    return MotionPrediction(mean, network_precision(spread))
