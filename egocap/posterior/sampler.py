"""emcee on one frame's posterior: started from its modes, run until autocorrelation is short.

Moves, drawn at random at every step: Crank and (between modes) Hop of `moves`, which
follow the shape about the modes, and differential evolution with and without snooker and the
stretch move, which do not depend on the modes. The chain grows until it is `LENGTHS` integrated
autocorrelation times long beyond a burn-in of `BURN_IN` of them, has the required effective draws
and an R-hat below `RHAT`; or until the limit of steps, and then the result states which criterion
failed.

Source: Foreman-Mackey et al. 2013 (emcee); Goodman & Weare 2010; ter Braak & Vrugt 2008; Sokal 1996
(autocorrelation time); Vehtari et al. 2021 (split R-hat).
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from emcee.backends import Backend
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.posterior.backend import NpzBackend
from egocap.posterior.config import FIRST_CHECK, SamplerConfig
from egocap.posterior.laplace import Mode, find_modes
from egocap.posterior.log_prob import LogPosterior
from egocap.posterior.moves import Crank, Hop, Mixture, Snooker
from egocap.posterior.result import Posterior

THIN = 5
"""Every this many steps one is kept."""
LENGTHS, BURN_IN = 50.0, 5.0
"""Minimum length of a chain, and burn-in, in autocorrelation times."""
GROWTH = 1.5
"""Growth of the chain between two checks."""
RHAT = 1.05
"""Limit of the potential scale reduction."""
KEPT_DRAWS = 6000
"""About the maximum number of draws in the result, evenly from the chain."""
_CRANKS = (0.15, 0.3, 0.6)
_FEW = (4, 8, 16)
"""Components that are redrawn together."""


@dataclass(frozen=True)
class Health:
    """Convergence diagnostics of a chain. Times are in steps."""

    autocorrelation: Float[Array, "N"]
    effective: Float[Array, "N"]
    rhat: Float[Array, "N"]
    burn_in: int
    steps: int

    def failure(self, names: tuple[str, ...], effective: float) -> str:
        """Why the chain has not mixed, with the numbers; empty when it has."""
        worst = int(np.argmax(self.autocorrelation))
        tau, length = self.autocorrelation[worst], self.steps - self.burn_in
        if not length >= LENGTHS * tau:
            return (f"not mixed: {length} steps after burn-in are {length / tau:.0f} "
                    f"autocorrelation times of {names[worst]} ({tau:.0f} steps), "
                    f"{LENGTHS:.0f} are needed")  # fmt: skip
        apart = int(np.argmax(self.rhat))
        if not self.rhat[apart] <= RHAT:
            return (f"not mixed: walkers disagree about {names[apart]}, "
                    f"R-hat {self.rhat[apart]:.3f} above {RHAT}")  # fmt: skip
        fewest = int(np.argmin(self.effective))
        if not self.effective[fewest] >= effective:
            return (f"too short: {self.effective[fewest]:.0f} effective draws of {names[fewest]}, "
                    f"{effective:.0f} are needed")  # fmt: skip
        return ""


def sample(
    density: LogPosterior,
    config: SamplerConfig = SamplerConfig(),  # noqa: B008 (frozen)
    *,
    frame: int = 0,
    time_s: float = 0.0,
    source: str = "",
    starts: Float[Array, "S 37"] | None = None,
    checkpoint: Path | None = None,
) -> Posterior:
    """Draw from a posterior. Not mixing is data on the result, not an exception.

    `frame`, `time_s` and `source` are copied to the result. `starts` are additional starting poses,
    such as the tracker's. With a `checkpoint` the chain is saved there and continued:
    an interrupted run ends with the same draws. Raises InputError, FileError.
    """
    walkers = config.walkers_for(density.size)
    began = time.perf_counter()
    modes = find_modes(density, np.random.default_rng(config.seed), starts)
    mixture = _mixture(modes)
    random = np.random.RandomState(config.seed)
    backend: Backend = Backend()
    if checkpoint is not None:
        backend = NpzBackend(checkpoint, fingerprint(density, config, starts))
    fresh = not (backend.initialized and backend.iteration > 0)
    sampler = emcee.EnsembleSampler(
        walkers,
        density.size,
        density,
        vectorize=True,
        moves=_moves(mixture),
        backend=backend,
    )
    state: Any = None
    if fresh:
        first = mixture.draw(walkers, random)
        state = emcee.State(first, random_state=random.get_state())
    health = _grow(sampler, state, density.names, config)
    failure = health.failure(density.names, config.effective)
    if isinstance(backend, NpzBackend):
        backend.save()
    return _result(
        density, sampler, modes, mixture, health,
        mixed=not failure,
        outcome=failure or f"mixed: {health.effective.min():.0f} effective draws or more",
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
    # How long a chain may grow does not change its beginning.
    of_chain = {"walkers": config.walkers_for(density.size), "seed": config.seed}
    text = [str(density.config), density.rig.to_dict(), of_chain, density.extra is not None]
    digest.update(json.dumps(text, sort_keys=True).encode())
    return digest.hexdigest()


def examine(chain: Float[Array, "S W N"], thin: int = THIN) -> Health:
    """Autocorrelation, effective draws and agreement of a chain that keeps every `thin`-th step."""
    kept = len(chain)
    tau = emcee.autocorr.integrated_time(chain[kept // 5 :], tol=0, quiet=True)
    tau = np.where(np.isfinite(tau), np.maximum(tau, 1.0), kept)  # not finite: it never moved
    burn_in = min(int(np.ceil(BURN_IN * tau.max())), kept // 2)
    rest = chain[burn_in:]
    return Health(
        autocorrelation=thin * tau,
        effective=rest.shape[1] * len(rest) / tau,
        rhat=split_rhat(rest),
        burn_in=thin * burn_in,
        steps=thin * kept,
    )


def split_rhat(chain: Float[Array, "S W N"]) -> Float[Array, "N"]:
    """Potential scale reduction of walkers cut in halves; infinite when nothing moved."""
    half = len(chain) // 2
    parts = np.concatenate([chain[:half], chain[half : 2 * half]], axis=1)
    within = parts.var(axis=0, ddof=1).mean(0)
    between = parts.mean(0).var(axis=0, ddof=1)
    safe = np.where(within > 0, within, 1.0)
    return np.where(within > 0, np.sqrt((half - 1) / half + between / safe), np.inf)


def _grow(
    sampler: emcee.EnsembleSampler, state: Any, names: tuple[str, ...], config: SamplerConfig
) -> Health:
    """Run until the chain has converged or reached its limit.

    It is checked after fixed numbers of steps, so that a continued chain ends where an
    uninterrupted one does.
    """
    target = FIRST_CHECK
    while True:
        target = min(target, config.most_steps)
        missing = target // THIN - sampler.backend.iteration if state is None else target // THIN
        if state is not None or missing > 0:
            sampler.run_mcmc(state, missing, thin_by=THIN)
            state = None
        health = examine(sampler.get_chain()[: target // THIN])  # pyright: ignore[reportOptionalSubscript]
        if target >= config.most_steps or not health.failure(names, config.effective):
            return health
        target = int(GROWTH * target)


def _mixture(modes: list[Mode]) -> Mixture:
    mass = np.array([mode.log_mass for mode in modes])
    # Every mode gets some walkers: they can leave it, but others may not find it.
    weights = np.maximum(np.exp(mass - mass.max()), 0.05)
    return Mixture(
        np.array([m.mean for m in modes]), np.array([m.covariance for m in modes]), weights
    )


def _moves(mixture: Mixture) -> list[tuple[Any, float]]:
    dimensions = mixture.means.shape[1]
    moves: list[tuple[Any, float]] = [
        (Crank(mixture, _CRANKS), 0.3),
        (Crank(mixture, (1.0,), _FEW), 0.4),
        (emcee.moves.DEMove(gamma0=2.38 / np.sqrt(2 * dimensions)), 0.15),
        (Snooker(), 0.1),
        (emcee.moves.StretchMove(), 0.05),
    ]
    return [*moves, (Hop(mixture), 0.2)] if len(mixture) > 1 else moves


def _result(
    density: LogPosterior, sampler: emcee.EnsembleSampler, modes: list[Mode], mixture: Mixture,
    health: Health, **rest: Any,
) -> Posterior:  # fmt: skip
    first = health.burn_in // THIN
    chain: Any = sampler.get_chain()
    log_prob: Any = sampler.get_log_prob()
    chain, log_prob = chain[first : health.steps // THIN], log_prob[first : health.steps // THIN]
    every = max(1, chain.shape[0] * chain.shape[1] // KEPT_DRAWS)
    draws = np.ascontiguousarray(np.swapaxes(chain[::every], 0, 1))
    flat = draws.reshape(-1, density.size)
    nearest = np.argmax(mixture.log_share(flat), axis=1)
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
        autocorrelation=health.autocorrelation,
        effective=health.effective,
        rhat=health.rhat,
        acceptance=float(np.mean(sampler.acceptance_fraction)),
        steps=health.steps,
        burn_in=health.burn_in,
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
