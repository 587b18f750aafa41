"""Is the rig rotated on the head? The trunk's attitude in the head frame, against that of people.

A rotation of the whole rig moves all rays alike, so that nothing in the detections contradicts it;
but it rolls or turns the body, and people seldom hold their heads so for a whole recording.
`attitude.json` beside this module holds the covariance of the median roll and yaw of recordings
that `egocap-eval learn-prior attitude` computes from a folder of motions. Pitch tells nothing:
people look down at what they do, or bend, for whole recordings.

Source: mixture of a rig that is right and one that is rotated, by Bayes' rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.errors import FileError
from egocap.files import write_json
from egocap.geometry import unit
from egocap.schema import Number, Strict, checked, read_json

FILE = Path(__file__).with_name("attitude.json")
AXES = ("roll", "yaw")
_ROTATED = 0.1
"""Prior probability of a rig that is rotated on the head by anything below `_RANGE`."""
_RANGE = np.deg2rad(45.0)


class _AttitudeFile(Strict):
    recordings: int
    covariance_deg2: tuple[tuple[Number, Number], tuple[Number, Number]]


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Covariance [rad^2] of the median roll and yaw of recordings; their mean is 0 by symmetry."""

    covariance: Float[Array, "2 2"]

    def probability(self, attitude: Float[Array, "3"]) -> float:
        """Of a rig that is not rotated on the head, given the median attitude of a recording."""
        off = attitude[::2]
        density = np.exp(-0.5 * off @ np.linalg.solve(self.covariance, off))
        density /= np.sqrt(np.linalg.det(2.0 * np.pi * self.covariance))
        right, rotated = (1.0 - _ROTATED) * density, _ROTATED / (2.0 * _RANGE) ** 2
        return float(right / (right + rotated))

    def oddest(self, attitude: Float[Array, "3"]) -> tuple[str, float]:
        """The axis about which an attitude is least usual, and its angle [rad]."""
        off = attitude[::2]
        axis = int(np.argmax(np.abs(off) / np.sqrt(np.diag(self.covariance))))
        return AXES[axis], float(off[axis])


def attitudes(joints_head: Float[Array, "*T 18 3"]) -> Float[Array, "*T 3"]:
    """Roll, pitch and yaw [rad] of the trunk in the head frame: 0 upright and facing ahead."""
    at = {name: joints_head[..., i, :] for i, name in enumerate(LABELS)}
    up = unit(at["neck"] - 0.5 * (at["left_hip"] + at["right_hip"]))
    left = at["left_shoulder"] - at["right_shoulder"] + at["left_hip"] - at["right_hip"]
    left = unit(left - up * np.sum(up * left, -1, keepdims=True))
    return np.stack([
        np.arctan2(-up[..., 1], up[..., 2]), np.arctan2(up[..., 0], up[..., 2]),
        np.arctan2(-left[..., 0], left[..., 1]),
    ], -1)  # fmt: skip


def learn_attitudes(recordings: Sequence[Float[Array, "T 18 3"]]) -> Attitudes:
    """From the joints of some recordings, in the head frame, and their mirrors."""
    medians = np.array([np.median(attitudes(joints)[:, ::2], axis=0) for joints in recordings])
    return Attitudes(medians.T @ medians / len(medians))


@cache
def load_attitudes(path: Path = FILE) -> Attitudes:
    """Read learned attitudes. Raises FileError."""
    data = checked(_AttitudeFile, read_json(path), path)
    covariance = np.deg2rad(1.0) ** 2 * np.array(data.covariance_deg2)
    if np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise FileError(path, "not positive definite", key="covariance_deg2")
    return Attitudes(covariance)


def save_attitudes(learned: Attitudes, recordings: int, path: Path = FILE) -> None:
    """Write learned attitudes, and of how many recordings they are."""
    covariance = (np.rad2deg(1.0) ** 2 * learned.covariance).round(2)
    write_json(path, {"recordings": recordings, "covariance_deg2": covariance.tolist()})
