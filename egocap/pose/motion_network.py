"""The motion network: how people's joints move together with each other and with the head.

In: a track without the motion prior, its joints' standard deviations and, where it is known, the
head's motion. Out: a Gaussian over every frame's angles, occluded ones included, which the smoother
adds as a term. Small convolutional networks over time, which see a second on either side, correct
the track's angles. They are averaged; each was trained without some of the subjects, so that they
disagree where a motion is unlike those learned. Learned from training motions
(`egocap-eval learn-prior network`); inference needs numpy alone.

Source: van den Oord et al. 2016, "WaveNet" (dilated convolutions over time); Lakshminarayanan
et al. 2017, "Simple and scalable predictive uncertainty estimation using deep ensembles"; Shao and
Tu 1995, "The jackknife and bootstrap", section 2.3 (variance of what groups are deleted from).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, DOFS, HasOffsets
from egocap.data.head_pose import HeadPoses
from egocap.errors import FileError
from egocap.files import read_npz, write_npz
from egocap.pose.motion_features import (
    GROUPS,
    HEAD_COUNT,
    POSE_COUNT,
    head_features,
    pose_features,
)
from egocap.pose.pose_prior import unlikeness
from egocap.series import interpolate

FILE = Path(__file__).with_name("motion_network.npz")
STEP_S = 1.0 / 15.0
"""Time between the network's steps."""
GAP_S = 2.0
"""Time without frames across which nothing is told."""
DILATIONS = (1, 2, 4, 8)
UNIT = np.deg2rad(10.0)
"""Unit of the network's outputs, rad."""
MOST_LOG_STD = 3.0
INPUTS = POSE_COUNT + HEAD_COUNT + len(GROUPS)


@dataclass(frozen=True, eq=False)
class MotionNetwork:
    """Weights of M networks of C channels, and the correlation of their errors."""

    into: Float[Array, "M 152 C"]
    into_bias: Float[Array, "M C"]
    blocks: Float[Array, "M 4 3 C C"]
    block_biases: Float[Array, "M 4 C"]
    out: Float[Array, "M C 74"]
    out_bias: Float[Array, "M 74"]
    correlation: Float[Array, "37 37"]

    def __call__(
        self, inputs: Float[Array, "N 152"]
    ) -> tuple[Float[Array, "N 37"], Float[Array, "N 37"]]:
        """Corrections of the angles and their standard deviations, rad, at every step."""
        hidden = inputs @ self.into + self.into_bias[:, None]
        for b, dilation in enumerate(DILATIONS):
            hidden = hidden + self.block_biases[:, b, None] + _convolve(
                _silu(hidden), self.blocks[:, b], dilation
            )  # fmt: skip
        means, log_std = np.split(_silu(hidden) @ self.out + self.out_bias[:, None], 2, axis=-1)
        variances = np.exp(2.0 * np.clip(log_std, -MOST_LOG_STD, MOST_LOG_STD))
        jackknife = (len(means) - 1) * means.var(axis=0)
        spread = variances.mean(axis=0) + jackknife
        return UNIT * means.mean(axis=0), UNIT * np.sqrt(spread)

    @cached_property
    def precision(self) -> Float[Array, "37 37"]:
        """Inverse of the errors' correlation."""
        return np.linalg.inv(self.correlation.astype(float))


def save_motion_network(network: MotionNetwork, path: Path = FILE) -> None:
    """Write a learned network as npz, in half precision."""
    arrays = {f.name: getattr(network, f.name).astype(np.float16) for f in fields(network)}
    write_npz(path, dofs=np.array(DOFS), **arrays)


@cache
def load_motion_network(path: Path = FILE) -> MotionNetwork:
    """Read a learned network. Raises FileError."""
    try:
        found = read_npz(path)
        names = MotionNetwork.__dataclass_fields__
        network = MotionNetwork(**{name: found[name].astype(np.float32) for name in names})
    except (FileError, ValueError, KeyError):
        raise FileError(path, "not a motion network") from None
    if not np.array_equal(found.get("dofs", ()), DOFS) or not _consistent(network):
        raise FileError(path, "not for this skeleton's angles", key="dofs")
    if not all(np.isfinite(array).all() for array in vars(network).values()):
        raise FileError(path, "not finite numbers")
    if np.linalg.eigvalsh(network.correlation.astype(float))[0] <= 0.0:
        raise FileError(path, "not positive definite", key="correlation")
    return network


def correct_track(
    times: Float[Array, "T"], angles: Float[Array, "T 37"], std: Float[Array, "T 18"],
    proportions: HasOffsets, heads: HeadPoses | None, network: MotionNetwork | None = None,
) -> tuple[Float[Array, "T 37"], Float[Array, "T 37"]]:  # fmt: skip
    """The angles as the network corrects them, and their standard deviations, rad.

    The deviations grow with the pose's squared distance from everyday ones
    (`pose_prior.unlikeness`): errors on subjects that were not learned from do grow with it. `std`
    are those of the joints, metres. Stretches of frames with a gap of more than `GAP_S` between
    them are corrected apart.
    """
    network = network or load_motion_network()
    mean, spread = np.empty_like(angles), np.empty_like(angles)
    edges = [0, *(np.flatnonzero(np.diff(times) > GAP_S) + 1), len(times)]
    for part in (slice(a, b) for a, b in pairwise(edges)):
        within = times[part]
        steps = np.arange(within[0], within[-1] + 0.001 * STEP_S, STEP_S)
        of_part = None if heads is None else heads[part]
        inputs = network_inputs(within, angles[part], std[part], proportions, of_part)
        correction, found = network(interpolate(steps, within, inputs).astype(np.float32))
        mean[part] = angles[part] + interpolate(within, steps, correction)
        wider = np.maximum(unlikeness(angles[part]), 1.0)
        spread[part] = interpolate(within, steps, found) * wider[:, None]
    return mean, spread


def network_precision(
    spread: Float[Array, "T 37"], network: MotionNetwork | None = None
) -> Float[Array, "T 37 37"]:
    """Precision [rad^-2] of corrected angles of these standard deviations."""
    between = (network or load_motion_network()).precision
    return between / (spread[:, :, None] * spread[:, None, :])


def network_inputs(
    times: Float[Array, "T"], angles: Float[Array, "T 37"], std: Float[Array, "T 18"],
    proportions: HasOffsets, heads: HeadPoses | None,
) -> Float[Array, "T 152"]:  # fmt: skip
    """Features of every frame, and which groups of the head's are known."""
    known = np.zeros(len(angles)) if heads is None else heads.known.astype(float)
    return np.concatenate([
        pose_features(angles, std, proportions),
        head_features(times, angles, proportions, heads),
        np.tile(known[:, None], len(GROUPS)),
    ], axis=1)  # fmt: skip


def _convolve(
    values: Float[Array, "M N C"], taps: Float[Array, "M 3 C C"], dilation: int
) -> Float[Array, "M N C"]:
    """Dilated convolution over time, padded with zeros."""
    members, count, channels = values.shape
    near = np.zeros((members, count, 3, channels), values.dtype)
    near[:, dilation:, 0] = values[:, :-dilation]
    near[:, :, 1] = values
    near[:, :-dilation, 2] = values[:, dilation:]
    return near.reshape(members, count, -1) @ taps.reshape(members, -1, channels)


def _silu(x: Float[Array, "*any"]) -> Float[Array, "*any"]:
    return x / (1.0 + np.exp(-x))


def _consistent(network: MotionNetwork) -> bool:
    if network.into.ndim != 3:
        return False
    members, channels = network.into.shape[0], network.into.shape[-1]
    expected = {
        "into": (members, INPUTS, channels), "into_bias": (members, channels),
        "blocks": (members, len(DILATIONS), 3, channels, channels),
        "block_biases": (members, len(DILATIONS), channels),
        "out": (members, channels, 2 * DOF_COUNT), "out_bias": (members, 2 * DOF_COUNT),
        "correlation": (DOF_COUNT, DOF_COUNT),
    }  # fmt: skip
    return members > 0 and all(getattr(network, n).shape == s for n, s in expected.items())
