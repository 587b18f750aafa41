"""The posterior's modes and a Gaussian about each: starting points of the sampler.

Levenberg-Marquardt climbs from many starts: the tracker's starting poses, poses drawn from the
prior, and the best pose with one limb replaced by a drawn one, which finds the alternatives of an
ambiguous arm. Modes within `APART` standard deviations of each other are merged.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, ch. 27; Nocedal & Wright,
Numerical Optimization, 2nd ed., section 10.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import DOF_COUNT, DOFS
from egocap.pose.initial_poses import start_poses
from egocap.pose.pose_prior import load_posture
from egocap.posterior.log_prob import LogPosterior
from egocap.posterior.synthetic_pose import draw_poses

DRAWN, A_LIMB = 16, 8
"""Starts drawn from the prior, and redrawings of every limb."""
APART = 4.0
"""Modes are different when they are this many standard deviations apart along some direction."""
FALL = 8.0
"""Modes with less than exp(-FALL) of the best one's probability are left out."""
_ROUGH, _FINE = 15, 60
_LIMBS = tuple(
    tuple(i for i, dof in enumerate(DOFS) if dof.startswith(f"{side}_{part}"))
    for side in ("left", "right")
    for part in ("shoulder", "hip")
)


@dataclass(frozen=True, eq=False)
class Mode:
    """A local maximum and the Gaussian of its curvature."""

    mean: Float[Array, "N"]
    covariance: Float[Array, "N N"]
    log_prob: float
    converged: bool

    @property
    def log_mass(self) -> float:
        """Logarithm of the Gaussian's integral, up to the constant that log_prob lacks."""
        _, log_determinant = np.linalg.slogdet(self.covariance)
        return self.log_prob + 0.5 * float(log_determinant)


def find_modes(
    density: LogPosterior, rng: np.random.Generator, starts: Float[Array, "S 37"] | None = None
) -> list[Mode]:
    """Modes of relevant mass, the heaviest first; never empty. `starts` are tried as well."""
    poses = [load_posture().mean[None], start_poses(), draw_poses(DRAWN, density.config, rng)]
    poses += [starts] if starts is not None else []
    rough = [_climb(density, _padded(density, pose), _ROUGH) for pose in np.concatenate(poses)]
    best = max(rough, key=lambda found: found[1])[0]
    rough += [_climb(density, theta, _ROUGH) for theta in _with_other_limbs(density, best, rng)]
    top = max(value for _, value, _ in rough)
    modes: list[Mode] = []
    for theta, value, _ in sorted(rough, key=lambda found: -found[1]):
        if value < top - 4.0 * FALL:  # volumes may make up for some of the height
            break
        if any(_same(mode, theta) for mode in modes):
            continue
        mode = _mode(density, theta)
        if not any(_same(other, mode.mean) for other in modes):
            modes.append(mode)
    heaviest = max(mode.log_mass for mode in modes)
    kept = [mode for mode in modes if mode.log_mass > heaviest - FALL]
    return sorted(kept, key=lambda mode: -mode.log_mass)


def _same(mode: Mode, theta: Float[Array, "N"]) -> bool:
    away = theta - mode.mean
    return bool(away @ np.linalg.solve(mode.covariance, away) < APART**2)


def _mode(density: LogPosterior, theta: Float[Array, "N"]) -> Mode:
    theta, value, converged = _climb(density, theta, _FINE)
    _, _, H = density.derivatives(theta, expected=True)
    covariance = np.linalg.inv(H)
    return Mode(theta, 0.5 * (covariance + covariance.T), value, converged)


def _padded(density: LogPosterior, angles: Float[Array, "37"]) -> Float[Array, "N"]:
    """Angles with scales and rig errors at their expected value."""
    return np.concatenate([angles, np.zeros(density.size - DOF_COUNT)])


def _with_other_limbs(
    density: LogPosterior, best: Float[Array, "N"], rng: np.random.Generator
) -> Float[Array, "S N"]:
    """The pose with an arm or a leg as in poses drawn from the prior, from its root downwards."""
    ends = {"shoulder": ("elbow", "wrist"), "hip": ("knee", "ankle")}
    starts = []
    for limb in _LIMBS:
        side, part = DOFS[limb[0]].split("_")[:2]
        below = tuple(f"{side}_{end}" for end in ends[part])
        dofs = [*limb, *(i for i, dof in enumerate(DOFS) if dof.startswith(below))]
        for pose in draw_poses(A_LIMB, density.config, rng):
            theta = best.copy()
            theta[dofs] = pose[dofs]
            starts.append(theta)
    return np.array(starts)


def _climb(
    density: LogPosterior, theta: Float[Array, "N"], steps: int
) -> tuple[Float[Array, "N"], float, bool]:
    """Damped Gauss-Newton uphill; returns where it ended, log posterior, convergence."""
    value, g, H = density.derivatives(theta)
    damping = 1e-3
    for _ in range(steps):
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        step *= 1.0 / max(1.0, np.abs(step).max())
        new, new_g, new_H = density.derivatives(theta + step)
        if new < value:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e8:
                return theta, value, True
            continue
        gain, theta, value, g, H = new - value, theta + step, new, new_g, new_H
        damping = max(0.2 * damping, 1e-9)
        if gain < 1e-6:
            return theta, value, True
    return theta, value, False
