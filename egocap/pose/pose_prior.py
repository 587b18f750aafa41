"""How people's joint angles go together: a Gaussian over whole postures, learned from motions.

A hidden joint is guessed better from those that are seen than from its limits: a bent hip goes with
a bent knee. `posture.json` beside this module holds the mean and covariance that
`egocap-eval learn-prior pose` computes from a folder of motions.

Source of the motions: CMU Graphics Lab Motion Capture Database (mocap.cs.cmu.edu, NSF EIA-0196217),
without the clips that the project keeps for validation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOFS, MIRROR_DOFS, MIRROR_SIGNS
from egocap.schema import Number, Strict, checked, read_json

FILE = Path(__file__).with_name("pose_prior.json")
FLOOR = np.deg2rad(3.0)
"""Scatter added to every angle, so that no combination of angles counts as impossible."""
POSES_A_MOTION = 60


class _PostureFile(Strict):
    dofs: tuple[str, ...]
    mean_deg: tuple[Number, ...]
    covariance_deg2: tuple[tuple[Number, ...], ...]  # lower triangle, row by row


@dataclass(frozen=True, eq=False)
class Posture:
    """Mean [rad] and precision [rad^-2] of everyday postures."""

    mean: Float[Array, "37"]
    precision: Float[Array, "37 37"]


def learn_posture(
    motions: Sequence[Float[Array, "T 37"]],
) -> tuple[Float[Array, "37"], Float[Array, "37 37"]]:
    """Mean and covariance of the postures in some motions, which count alike, and their mirrors."""
    poses = np.concatenate([m[:: max(1, len(m) // POSES_A_MOTION)] for m in motions])
    poses = np.concatenate([poses, poses[:, MIRROR_DOFS] * MIRROR_SIGNS])
    return poses.mean(0), np.cov(poses.T) + FLOOR**2 * np.eye(len(DOFS))


@cache
def load_posture(path: Path = FILE) -> Posture:
    """Read a learned posture. Raises FileError."""
    from egocap.errors import FileError

    data = checked(_PostureFile, read_json(path), path)
    n = len(DOFS)
    shapes = [len(row) for row in data.covariance_deg2] == list(range(1, n + 1))
    if data.dofs != DOFS or len(data.mean_deg) != n or not shapes:
        raise FileError(path, "not for this skeleton's angles", key="dofs", valid=f"{n} angles")
    covariance = np.zeros((n, n))
    for i, row in enumerate(data.covariance_deg2):
        covariance[i, : i + 1] = covariance[: i + 1, i] = np.deg2rad(1.0) ** 2 * np.array(row)
    if np.linalg.eigvalsh(covariance)[0] <= 0:
        raise FileError(path, "not positive definite", key="covariance_deg2")
    return Posture(np.deg2rad(data.mean_deg), np.linalg.inv(covariance))


def unlikeness(angles: Float[Array, "*n 37"]) -> Float[Array, "*n"]:
    """Squared distance of poses from everyday ones in their variances; its mean is 1."""
    posture = load_posture()
    away = np.asarray(angles) - posture.mean
    return np.sum(away @ posture.precision * away, axis=-1) / len(DOFS)


def save_posture(
    mean: Float[Array, "37"], covariance: Float[Array, "37 37"], path: Path = FILE
) -> None:
    """Write a learned posture; angles are rounded to a thousandth of a degree."""
    degrees = np.rad2deg(1.0)
    triangle = [(degrees**2 * row[: i + 1]).round(2).tolist() for i, row in enumerate(covariance)]
    rows = ",\n  ".join(str(row) for row in triangle)
    names = ", ".join(f'"{name}"' for name in DOFS)
    path.write_text(
        f'{{\n "dofs": [{names}],\n "mean_deg": {(degrees * mean).round(3).tolist()},\n'
        f' "covariance_deg2": [\n  {rows}\n ]\n}}\n',
        encoding="utf-8",
    )
