"""emcee on one frame's posterior: started from its modes, run until it has converged.

Moves, drawn at random at every step: Trajectory, Crank and (between modes) Hop of `moves`. They
need no ensemble, so that few walkers make long chains. A warm-up, which is not kept, adapts the
steps of the trajectories and replaces Laplace's covariances by those of the draws. Then the chain
grows until, without its first fifth, its rank-normalised split R-hat is at most
`convergence.RHAT` and it has the required effective draws; or until the limit of steps, and then
the result states which criterion failed.

Source: Foreman-Mackey et al. 2013 (emcee); Neal 2011 (Hamiltonian Monte Carlo); Vehtari et al. 2021
(R-hat, effective draws).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from emcee.backends import Backend
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError
from egocap.posterior.backend import NpzBackend
from egocap.posterior.config import FIRST_CHECK, SamplerConfig
from egocap.posterior.convergence import Health, examine
from egocap.posterior.laplace import Mode, find_modes
from egocap.posterior.log_prob import LogPosterior
from egocap.posterior.moves import Crank, Hop, Mixture, Trajectory
from egocap.posterior.result import Posterior

THIN = 2
"""Every this many steps one is kept."""
WARM_UP = (150, 250, 150)
"""Steps that adapt the moves and are not kept; covariances are estimated after each part."""
BURN_IN = 0.2
"""Fraction of the chain that is left out."""
GROWTH = 1.5
"""Growth of the chain between two checks."""
KEPT_DRAWS = 6000
"""About the maximum number of draws in the result, evenly from the chain."""
_FEW = (4, 8, 16)
"""Components that are redrawn together."""
_LEAST_DRAWS = 600
"""Draws of a mode in the warm-up from which its covariance is estimated."""

OnSteps = Callable[[int], None]
"""Called with the number of steps just made."""


def sample(
    density: LogPosterior,
    config: SamplerConfig = SamplerConfig(),  # noqa: B008 (frozen)
    *,
    frame: int = 0,
    time_s: float = 0.0,
    source: str = "",
    starts: Float[Array, "S 37"] | None = None,
    checkpoint: Path | None = None,
    on_steps: OnSteps = lambda count: None,
) -> Posterior:
    """Draw from a posterior. Not converging is data on the result, not an exception.

    `frame`, `time_s` and `source` are copied to the result. `starts` are additional starting poses,
    such as the tracker's. With a `checkpoint` the chain is saved there and continued:
    an interrupted run ends with the same draws. Raises FileError.
    """
    began = time.perf_counter()
    modes = find_modes(density, np.random.default_rng(config.seed), starts)
    random = np.random.RandomState(config.seed)
    state, moves = _warm_up(density, _mixture(modes), config.walkers, random)
    backend: Backend = Backend()
    if checkpoint is not None:
        backend = NpzBackend(checkpoint, fingerprint(density, config, starts))
        if backend.initialized and backend.shape != (config.walkers, density.size):
            raise FileError(checkpoint, f"a chain of shape {backend.shape}",
                            valid=f"{(config.walkers, density.size)}")  # fmt: skip
    sampler = _sampler(density, config.walkers, moves, backend)
    if backend.initialized and backend.iteration > 0:
        state = backend.get_last_sample()
    health, steps = _grow(sampler, state, density.names, config, on_steps)
    failure = health.failure(density.names, config.effective)
    if isinstance(backend, NpzBackend):
        backend.save()
    least = min(health.effective.min(), health.tail_effective.min())
    return _result(
        density, sampler, modes, health, steps,
        converged=not failure,
        outcome=failure or f"converged: R-hat {health.rhat.max():.3f}, {least:.0f} effective draws "
        "or more",
        frame=frame, time=time_s, seconds=time.perf_counter() - began,
        config={"posterior": asdict(density.config) | _finite(density.config.degrees),
                "sampler": asdict(config), "detections": source, "rig": density.rig.name},
    )  # fmt: skip


def fingerprint(
    density: LogPosterior, config: SamplerConfig, starts: Float[Array, "S 37"] | None = None
) -> str:
    """Hash of everything that the draws depend on."""
    digest = hashlib.sha256()
    m = density.measurement
    for array in (m.pixels, m.whiten, m.weights, density.proportions.offsets, starts):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    if density.extra is not None:  # images, by what they add at some poses
        poses = density.prior.mean[None] if starts is None else starts
        digest.update(" ".join(f"{value:.6g}" for value in density.extra(poses)).encode())
    # How long a chain may grow does not change its beginning.
    of_chain = {"walkers": config.walkers, "seed": config.seed}
    text = [str(density.config), density.rig.to_dict(), of_chain, density.extra is not None]
    digest.update(json.dumps(text, sort_keys=True).encode())
    return digest.hexdigest()


def _sampler(
    density: LogPosterior, walkers: int, moves: list[tuple[Any, float]], backend: Backend
) -> emcee.EnsembleSampler:
    return emcee.EnsembleSampler(
        walkers, density.size, density, vectorize=True, moves=moves, backend=backend
    )


def _warm_up(
    density: LogPosterior, mixture: Mixture, walkers: int, random: np.random.RandomState
) -> tuple[emcee.State, list[tuple[Any, float]]]:
    """Where the walkers are after the warm-up, and the adapted moves."""
    state: Any = emcee.State(mixture.draw(walkers, random), random_state=random.get_state())
    moves = _moves(density, mixture)
    for steps in WARM_UP:
        sampler = _sampler(density, walkers, moves, Backend())
        # emcee's check of the start is for moves that need an ensemble.
        state = sampler.run_mcmc(state, steps, tune=True, skip_initial_state_check=True)
        chain: Any = sampler.get_chain(discard=steps // 4, flat=True)
        mixture = _refined(mixture, chain)
        size = moves[0][0].size
        moves = _moves(density, mixture, size)
    return state, moves


def _refined(mixture: Mixture, draws: Float[Array, "B N"]) -> Mixture:
    """The mixture with the moments of its components' own draws, where these are many."""
    nearest = np.argmax(mixture.log_share(draws), axis=1)
    means, covariances = mixture.means.copy(), mixture.covariances.copy()
    for k in range(len(mixture)):
        own = draws[nearest == k]
        if len(own) >= _LEAST_DRAWS:
            means[k], covariances[k] = own.mean(axis=0), np.cov(own.T)
    return Mixture(means, covariances, mixture.weights)


def _grow(
    sampler: emcee.EnsembleSampler, state: Any, names: tuple[str, ...], config: SamplerConfig,
    on_steps: OnSteps,
) -> tuple[Health, int]:  # fmt: skip
    """Run until the chain has converged or reached its limit; diagnostics and steps.

    It is checked after fixed numbers of steps, so that a continued chain ends where an
    uninterrupted one does.
    """
    target = FIRST_CHECK
    on_steps(THIN * sampler.backend.iteration)
    while True:
        target = min(target, config.most_steps)
        missing = max(target // THIN - sampler.backend.iteration, 0)
        for made in sampler.sample(
            state, iterations=missing, thin_by=THIN, skip_initial_state_check=True
        ):
            state = made
            on_steps(THIN)
        health = examine(_kept(sampler.get_chain(), target))
        if target >= config.most_steps or not health.failure(names, config.effective):
            return health, target
        target = int(GROWTH * target)


def _kept(chain: Any, steps: int) -> Any:
    """The part of a chain of so many steps that counts."""
    return chain[int(BURN_IN * steps) // THIN : steps // THIN]


def _mixture(modes: list[Mode]) -> Mixture:
    mass = np.array([mode.log_mass for mode in modes])
    return Mixture(
        np.array([m.mean for m in modes]), np.array([m.covariance for m in modes]),
        np.exp(mass - mass.max()),
    )  # fmt: skip


def _moves(density: LogPosterior, mixture: Mixture, size: float = 0.2) -> list[tuple[Any, float]]:
    moves = [
        (Trajectory(mixture, density.leapfrog, size), 0.8),
        (Crank(mixture, (1.0,), _FEW), 0.1),
    ]
    return [*moves, (Hop(mixture), 0.1)] if len(mixture) > 1 else moves


def _result(
    density: LogPosterior, sampler: emcee.EnsembleSampler, modes: list[Mode], health: Health,
    steps: int, **rest: Any,
) -> Posterior:  # fmt: skip
    chain, log_prob = _kept(sampler.get_chain(), steps), _kept(sampler.get_log_prob(), steps)
    every = max(1, chain.shape[0] * chain.shape[1] // KEPT_DRAWS)
    draws = np.ascontiguousarray(np.swapaxes(chain[::every], 0, 1))
    flat = draws.reshape(-1, density.size)
    nearest = np.argmax(_mixture(modes).log_share(flat), axis=1)
    best = modes[0]
    return Posterior(
        names=density.names,
        draws=draws,
        log_prob=np.ascontiguousarray(log_prob[::every].T),
        joints=density.joints(flat).reshape(*draws.shape[:2], -1, 3),
        modes=np.array([mode.mean for mode in modes]),
        mode_log_mass=np.array([mode.log_mass - best.log_mass for mode in modes]),
        mode_share=np.bincount(nearest, minlength=len(modes)) / len(flat),
        laplace_joints=laplace_joints(density, best),
        effective=health.effective,
        tail_effective=health.tail_effective,
        rhat=health.rhat,
        acceptance=float(np.mean(sampler.acceptance_fraction)),
        steps=steps,
        burn_in=int(BURN_IN * steps),
        notes=density.measurement.notes,
        **rest,
    )


def laplace_joints(density: LogPosterior, mode: Mode) -> Float[Array, "18 3 3"]:
    """Covariance [m^2] of the joints' places by the Gaussian about a mode, to first order."""
    step = 1e-6
    moved = mode.mean + step * np.concatenate([np.eye(density.size), -np.eye(density.size)])
    places = density.joints(moved)
    J = np.moveaxis(places[: density.size] - places[density.size :], 0, -1) / (2.0 * step)
    return J @ mode.covariance @ np.swapaxes(J, -1, -2)


def _finite(degrees: float) -> dict[str, Any]:
    """JSON has no infinity."""
    return {"degrees": degrees if np.isfinite(degrees) else "inf"}
