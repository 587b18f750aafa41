"""Fixed-interval smoother over all frames, and the paper's Gaussian low-pass.

The interval smoother minimises the sum of all frames' energies and of the accelerations between
them, by damped Gauss-Newton. A frame's unknowns are coupled to those of the next two only: the
normal equations are banded, and a step takes a fraction of a millisecond a frame.

Source: Bell 1994, "The iterated Kalman smoother as a Gauss-Newton method", SIAM J. Optimization;
Gaussian low-pass: EgoCap 2016, section 4.4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray as Array

from egocap.body.skeleton import AGILITY, DOF_COUNT
from egocap.pose.banded import add_block, solve_damped
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil
from egocap.pose.kernel import Model, detections, motion_term, priors
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Observations, Rays

WINDOW, MARGIN = 400, 40
"""Frames solved at once, and frames of context on either side."""
BAND = 2 * DOF_COUNT
BandedSystem: TypeAlias = tuple[float, Float[Array, "K M"], Float[Array, "M"]]
"""Energy, Gauss-Newton matrix as LAPACK's lower band, and gradient."""
System: TypeAlias = Callable[[Float[Array, "T N"]], BandedSystem]
"""The banded system at some states."""
_SETTLED = 1e-3
"""Last step of a frame, rad, below which it has converged even if its window has not."""


class Minimum(NamedTuple):
    """States that minimise an energy."""

    states: Float[Array, "T N"]
    converged: Bool[Array, "T"]
    system: BandedSystem  # at the states


def smooth_interval(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction = NO_MOTION_PREDICTION,
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:  # fmt: skip
    """Refine a track with past and future frames. Returns angles and convergence of every frame.

    Long motions are solved in overlapping windows. `prediction` adds the motion prior's term.
    """
    refined, converged = angles.copy(), np.zeros(len(angles), bool)
    for kept, window, within in windows(len(angles)):
        solved, done = _solve_window(
            angles[window], observations[window], model, config, prediction[window]
        )
        refined[kept], converged[kept] = solved[within], done[within]
    return refined, converged


def windows(frames: int) -> list[tuple[slice, slice, slice]]:
    """Overlapping windows: frames to keep, frames to solve with them, those kept within these."""
    found = []
    for first in range(0, frames, WINDOW):
        last, low = min(first + WINDOW, frames), max(first - MARGIN, 0)
        found.append((slice(first, last), slice(low, min(last + MARGIN, frames)),
                      slice(first - low, last - low)))  # fmt: skip
    return found


def interval_system(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction = NO_MOTION_PREDICTION,
) -> BandedSystem:  # fmt: skip
    """Energy of all frames, its Gauss-Newton matrix as LAPACK's band, and its gradient."""
    return interval_energy(observations, model, config, prediction)(angles)


def interval_energy(
    observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction = NO_MOTION_PREDICTION,
) -> System:  # fmt: skip
    """`interval_system` as a function of the angles; what they do not change is made once."""
    seen, stencil = observations.arrays, acceleration_stencil(observations.times)
    scale, density = float(config.robust_scale), config.acceleration_sigma * AGILITY
    precision = config.lambda_motion * prediction.precision

    def system(angles: Float[Array, "T 37"]) -> BandedSystem:
        bands, gradient = np.zeros((BAND + 1, angles.size), order="F"), np.zeros(angles.size)
        energy = assemble(
            model, np.ascontiguousarray(angles), seen, scale, stencil, density, prediction.mean,
            precision, bands, gradient,
        )  # fmt: skip
        return float(energy), bands, gradient

    return system


def smooth_gaussian(angles: Float[Array, "T 37"], sigma_frames: float) -> Float[Array, "T 37"]:
    """Gaussian low-pass over five frames, renormalised at the ends."""
    if sigma_frames <= 0:
        return angles
    offsets = np.arange(-2, 3)
    taps = np.exp(-0.5 * (offsets / sigma_frames) ** 2)
    inside = np.pad(np.ones(len(angles)), 2)
    padded = np.pad(angles, ((2, 2), (0, 0)))
    windows = np.arange(len(angles))[:, None] + np.arange(5)  # (T, 5)
    weights = taps * inside[windows]
    total = np.einsum("tk,tkd->td", weights, padded[windows])
    return total / weights.sum(axis=1, keepdims=True)


def _solve_window(
    angles: Float[Array, "T 37"], observations: Observations, model: Model, config: TrackerConfig,
    prediction: MotionPrediction,
) -> tuple[Float[Array, "T 37"], Bool[Array, "T"]]:  # fmt: skip
    system = interval_energy(observations, model, config, prediction)
    return minimise(angles, system, config.max_iterations, config.tolerance)[:2]


def minimise(
    start: Float[Array, "T N"], system: System, max_steps: int, tolerance: float
) -> Minimum:
    """Damped Gauss-Newton on a banded system.

    Converged: a step lowered the energy by less than `tolerance` of itself.
    """
    states, found = start, system(start)
    damping, last_step = 1e-4, np.full(states.shape, np.inf)
    for _ in range(int(max_steps)):
        energy, bands, gradient = found
        step = solve_damped(bands, -gradient, damping)
        if step is None:
            damping = max(10.0 * damping, 1e-6)
            continue
        step = np.clip(step, -0.5, 0.5).reshape(states.shape)
        trial = states + step
        new = system(trial)
        if new[0] > energy:
            damping = max(10.0 * damping, 1e-3)
            continue
        states, found, last_step = trial, new, step
        damping = max(0.1 * damping, 1e-9)
        if energy - new[0] <= tolerance * new[0]:
            return Minimum(states, np.ones(len(states), bool), found)
    return Minimum(states, np.abs(last_step).max(axis=1) < _SETTLED, found)


@njit(cache=True, nogil=True)
def assemble(model, angles, seen, scale, stencil, density, mean, precision, bands, gradient):
    """Energy of a window; its Gauss-Newton matrix into `bands` (75, T*37), gradient into (T*37,).

    `seen` are the `Rays` of all frames. `mean` (T, 37) and `precision` (T, 37, 37) are the motion
    prior's; both may be empty. `bands[k, i]` is element (i + k, i), as LAPACK stores a symmetric
    band.
    """
    frames, dofs = angles.shape
    H, g = np.empty((dofs, dofs)), np.empty(dofs)
    energy = 0.0
    for t in range(frames):
        H[:] = 0.0
        g[:] = 0.0
        frame = Rays(seen.centres, seen.rays[t], seen.whiten[t], seen.weights[t])
        energy += detections(model, angles[t], frame, scale, H, g)
        energy += priors(model, angles[t], H, g)
        if len(mean) > 0:
            energy += motion_term(angles[t], mean[t], precision[t], H, g)
        add_block(H, g, t * dofs, bands, gradient)
    return energy + accelerations(angles, stencil, density, bands, gradient)


@njit(cache=True, nogil=True)
def accelerations(angles, stencil, density, bands, gradient):
    """Energy of a window's accelerations; their terms are added as `assemble` does."""
    frames, dofs = angles.shape
    energy = 0.0
    for t in range(frames - 2):
        s0, s1, s2 = stencil[t, 0], stencil[t, 1], stencil[t, 2]
        for d in range(dofs):
            x = s0 * angles[t, d] + s1 * angles[t + 1, d] + s2 * angles[t + 2, d]
            x /= density[d]
            root = np.sqrt(1.0 + x * x)
            energy += root - 1.0
            slope = x / root / density[d]
            w = 1.0 / root / density[d] ** 2
            i, j, k = t * dofs + d, (t + 1) * dofs + d, (t + 2) * dofs + d
            gradient[i] += slope * s0
            gradient[j] += slope * s1
            gradient[k] += slope * s2
            bands[0, i] += w * s0 * s0
            bands[0, j] += w * s1 * s1
            bands[0, k] += w * s2 * s2
            bands[dofs, i] += w * s0 * s1
            bands[dofs, j] += w * s1 * s2
            bands[2 * dofs, i] += w * s0 * s2
    return energy
