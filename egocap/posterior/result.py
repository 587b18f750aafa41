"""A sampled posterior, in memory and as npz."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.data.arrays import record_of
from egocap.errors import FileError, require
from egocap.files import read_npz, write_npz

KIND, SCHEMA = "egocap-posterior", 2


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """Draws from the posterior of one frame, with convergence diagnostics.

    Parameters N: 37 angles [rad], then scales (ln of the factor) and rig errors [rad, m] if they
    are inferred. Walkers W, draws S of each. If `converged` is False, the draws do not represent
    the posterior; `outcome` gives the reason.
    """

    names: tuple[str, ...]
    draws: Float[Array, "W S N"]
    log_prob: Float[Array, "W S"]
    joints: Float[Array, "W S 18 3"]  # head frame, metres
    modes: Float[Array, "K N"]  # that the walkers started from, the heaviest first
    mode_log_mass: Float[Array, "K"]  # Laplace's, relative to the heaviest
    mode_share: Float[Array, "K"]  # of the draws
    laplace_joints: Float[Array, "18 3 3"]  # covariance [m^2] about the heaviest mode
    effective: Float[Array, "N"]  # draws in the whole chain, for the bulk
    tail_effective: Float[Array, "N"]  # draws, for the 5 and 95 % quantiles
    rhat: Float[Array, "N"]  # rank-normalised, walkers split in halves; 1 is perfect
    acceptance: float
    steps: int
    burn_in: int
    converged: bool
    outcome: str
    notes: tuple[str, ...]
    frame: int
    time: float  # seconds
    seconds: float  # wall time of sampling
    config: dict[str, Any]  # settings and sources, JSON-ready

    @property
    def flat(self) -> Float[Array, "B N"]:
        """All draws of all walkers."""
        return self.draws.reshape(-1, self.draws.shape[-1])

    @property
    def flat_joints(self) -> Float[Array, "B 18 3"]:
        """Joints of all draws, head frame, metres."""
        return self.joints.reshape(-1, *self.joints.shape[-2:])

    @property
    def joint_mean(self) -> Float[Array, "18 3"]:
        """Mean place of every joint, head frame, metres."""
        return self.flat_joints.mean(0)

    @property
    def joint_covariance(self) -> Float[Array, "18 3 3"]:
        """Covariance of every joint's place, m^2."""
        away = self.flat_joints - self.joint_mean
        return np.einsum("bji,bjk->jik", away, away) / (len(away) - 1)

    def summary(self) -> dict[str, Any]:
        """Spread of the joints in mm and convergence diagnostics, JSON-ready."""
        return {
            "frame": self.frame,
            "converged": self.converged,
            "outcome": self.outcome,
            "notes": list(self.notes),
            "steps": self.steps,
            "seconds": round(self.seconds, 1),
            "acceptance": round(self.acceptance, 3),
            "least_effective": round(float(self.effective.min())),
            "least_tail_effective": round(float(self.tail_effective.min())),
            "largest_rhat": round(float(self.rhat.max()), 4),
            "mode_shares": [round(float(share), 3) for share in self.mode_share],
            "spread_mm": _spread_mm(self.joint_covariance),
            "laplace_spread_mm": _spread_mm(self.laplace_joints),
        }

    def __repr__(self) -> str:
        walkers, draws, size = self.draws.shape
        return (
            f"Posterior(frame {self.frame}: {walkers} walkers x {draws} draws of {size} parameters;"
            f" {self.outcome})"
        )


def _spread_mm(covariance: Float[Array, "18 3 3"]) -> dict[str, float]:
    spread = 1e3 * np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    return {name: round(float(value), 1) for name, value in zip(LABELS, spread, strict=True)}


def save_posterior(path: str | Path, posterior: Posterior) -> None:
    """Write a posterior as npz, whole or not at all."""
    arrays = {f.name: getattr(posterior, f.name) for f in fields(posterior)}
    arrays["config"] = json.dumps(arrays["config"])
    for name in ("names", "notes"):
        arrays[name] = np.array(arrays[name], dtype=str)
    write_npz(Path(path), kind=KIND, schema_version=SCHEMA, **arrays)


def load_posterior(path: str | Path) -> Posterior:
    """Read a posterior; FileError names what is missing or damaged."""
    path = Path(path)
    found: dict[str, Any] = read_npz(path)
    if str(found.pop("kind", "")) != KIND:
        raise FileError(path, "not a posterior", key="kind", valid=KIND)
    version = found.pop("schema_version", np.array(0))
    if version.shape != () or version != SCHEMA:
        raise FileError(path, "of another version", key="schema_version", valid=str(SCHEMA))
    names = [f.name for f in fields(Posterior)]
    if set(found) != set(names):
        wrong = sorted(set(found) ^ set(names))
        raise FileError(path, f"missing or unknown arrays: {', '.join(wrong)}", valid=names)
    posterior = record_of(path, Posterior, found)
    if not 0 < len(posterior.names) == posterior.draws.shape[2] or len(posterior.flat) < 2:
        raise FileError(path, f"{len(posterior.names)} names for draws {posterior.draws.shape}")
    for name in ("effective", "tail_effective"):
        if not np.isfinite(getattr(posterior, name)).all():
            raise FileError(path, "holds values that are not finite", key=name)
    return posterior


def to_arviz(posterior: Posterior) -> Any:
    """The draws as ArviZ's InferenceData: one variable a parameter, chains are walkers.

    Raises MachineError without the package.
    """
    from importlib import import_module

    require("arviz", "posterior")
    arviz = import_module("arviz")
    variables = {name: posterior.draws[..., i] for i, name in enumerate(posterior.names)}
    return arviz.from_dict(posterior=variables, sample_stats={"lp": posterior.log_prob})
