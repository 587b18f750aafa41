"""Proposals for emcee from a mixture of Gaussians that approximates the posterior.

`Trajectory` follows the gradient in the metric of a walker's Gaussian (Hamiltonian Monte Carlo);
where the posterior is curved or has walls it goes much farther than a random walk. `Crank` turns a
walker about the mean of its Gaussian, in that Gaussian's metric. It samples the Gaussian itself
without rejection in any number of dimensions, where a stretch move's steps shrink; rejections
correct for the difference from the posterior. `Hop` moves a walker from one Gaussian to
the same whitened place in another, which balances the modes. Both draw the Gaussian by its
responsibility for the walker; the probability of the reverse draw enters the acceptance.

Source: Neal 1999, "Regression and classification using Gaussian process priors"; Cotter et al.
2013, "MCMC methods for functions"; Neal 2011, "MCMC using Hamiltonian dynamics"; Tjelmeland &
Hegstad 2001, "Mode jumping proposals in MCMC".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from emcee.moves import MHMove
from jaxtyping import Float, Int
from numpy import ndarray as Array

Random = np.random.RandomState  # emcee's kind of generator

_MOST_LEAPS = 24
"""Maximum number of steps of a trajectory."""
_ACCEPTANCE, _TUNING = 0.75, 0.05
"""Acceptance of trajectories to reach, and rate of adapting their steps to it."""


class Mixture:
    """Gaussians with weights; `weights` need not be normalised."""

    def __init__(
        self,
        means: Float[Array, "K N"],
        covariances: Float[Array, "K N N"],
        weights: Float[Array, "K"],
    ) -> None:
        from scipy.linalg import solve_triangular

        self.means, self.covariances = np.array(means), np.array(covariances)
        self.weights = np.array(weights) / np.sum(weights)
        self.roots = np.linalg.cholesky(self.covariances)
        eye = np.eye(self.means.shape[1])
        self.inverse_roots = np.array(
            [solve_triangular(root, eye, lower=True) for root in self.roots]
        )
        self.log_volumes = np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)

    def __len__(self) -> int:
        return len(self.means)

    def white(self, x: Float[Array, "W N"], which: Int[Array, "W"]) -> Float[Array, "W N"]:
        """Standard deviations from the mean of each walker's Gaussian."""
        z = np.empty_like(x)
        for k in range(len(self)):
            mine = which == k
            z[mine] = (x[mine] - self.means[k]) @ self.inverse_roots[k].T
        return z

    def coloured(self, z: Float[Array, "W N"], which: Int[Array, "W"]) -> Float[Array, "W N"]:
        """The inverse of `white`."""
        x = np.empty_like(z)
        for k in range(len(self)):
            mine = which == k
            x[mine] = self.means[k] + z[mine] @ self.roots[k].T
        return x

    def log_share(self, x: Float[Array, "W N"]) -> Float[Array, "W K"]:
        """Log responsibility of every Gaussian for every walker."""
        if len(self) == 1:
            return np.zeros((len(x), 1))
        logs = np.empty((len(x), len(self)))
        for k in range(len(self)):
            z = (x - self.means[k]) @ self.inverse_roots[k].T
            logs[:, k] = np.log(self.weights[k]) - self.log_volumes[k] - 0.5 * np.sum(z * z, axis=1)
        return logs - np.logaddexp.reduce(logs, axis=1)[:, None]

    def draw_component(self, log_share: Float[Array, "W K"], rng: Random) -> Int[Array, "W"]:
        """A Gaussian for every walker, by responsibility."""
        if len(self) == 1:
            return np.zeros(len(log_share), int)
        return np.argmax(log_share + rng.gumbel(size=log_share.shape), axis=1)

    def draw(self, count: int, rng: Random) -> Float[Array, "W N"]:
        """Points from the mixture."""
        which = rng.choice(len(self), size=count, p=self.weights)
        return self.coloured(rng.standard_normal((count, self.means.shape[1])), which)


class Crank(MHMove):
    """x' = mean + L z', z' = sqrt(1 - b^2) z + b xi, with b drawn from `steps` at every step.

    With `few`, only about that many components of z change, which allows longer steps.
    """

    def __init__(
        self, mixture: Mixture, steps: Sequence[float], few: Sequence[int] | None = None
    ) -> None:
        super().__init__(self._propose, ndim=mixture.means.shape[1])
        self._mixture, self._steps = mixture, tuple(steps)
        self._few = (mixture.means.shape[1],) if few is None else tuple(few)

    def _propose(
        self, x: Float[Array, "W N"], rng: Random
    ) -> tuple[Float[Array, "W N"], Float[Array, "W"]]:
        mixture, rows = self._mixture, np.arange(len(x))
        b = np.asarray(self._steps)[rng.randint(len(self._steps), size=len(x))][:, None]
        few = np.asarray(self._few)[rng.randint(len(self._few), size=len(x))][:, None]
        before = mixture.log_share(x)
        which = mixture.draw_component(before, rng)
        z = mixture.white(x, which)
        new_z = np.sqrt(1.0 - b * b) * z + b * rng.standard_normal(z.shape)
        new_z = np.where(rng.rand(*z.shape) * z.shape[1] < few, new_z, z)
        new = mixture.coloured(new_z, which)
        # Reversible for the Gaussian: q(x | x') / q(x' | x) = N(x) / N(x').
        factor = 0.5 * np.sum(new_z * new_z - z * z, axis=1)
        return new, factor + mixture.log_share(new)[rows, which] - before[rows, which]


class Trajectory(MHMove):
    """A leapfrog trajectory of random length; emcee evaluates the density at its end.

    `leapfrog` (roots, which, sizes, steps, thetas, momenta) changes the last two in place, as
    `hamiltonian.leapfrog` does. Its force need not be the gradient of the sampled density:
    rejection corrects for the difference. While emcee tunes, the step's size is adapted to the
    acceptance.
    """

    def __init__(self, mixture: Mixture, leapfrog: Callable[..., None], size: float = 0.2) -> None:
        super().__init__(self._propose, ndim=mixture.means.shape[1])
        self._mixture, self._leapfrog, self.size = mixture, leapfrog, size

    def tune(self, state: Any, accepted: Array) -> None:  # emcee's name
        """Change the size of the steps towards the acceptance wanted."""
        self.size = min(self.size * np.exp(_TUNING * (np.mean(accepted) - _ACCEPTANCE)), 1.0)

    def _propose(
        self, x: Float[Array, "W N"], rng: Random
    ) -> tuple[Float[Array, "W N"], Float[Array, "W"]]:
        mixture, rows = self._mixture, np.arange(len(x))
        before = mixture.log_share(x)
        which = mixture.draw_component(before, rng)
        # Random lengths and sizes: none can be in step with a period of the motion.
        sizes = self.size * np.exp(-rng.rand(len(x)))
        steps = rng.randint(1, _MOST_LEAPS + 1, size=len(x))
        new, momenta = x.copy(), rng.standard_normal(x.shape)
        factor = 0.5 * np.sum(momenta * momenta, axis=1)
        self._leapfrog(mixture.roots, which, sizes, steps, new, momenta)
        factor -= 0.5 * np.sum(momenta * momenta, axis=1)
        lost = ~(np.isfinite(new).all(axis=1) & np.isfinite(factor))
        new[lost] = x[lost]
        factor += mixture.log_share(new)[rows, which] - before[rows, which]
        return new, np.where(lost, -np.inf, factor)


class Hop(MHMove):
    """The same standard deviations from the mean of another Gaussian."""

    def __init__(self, mixture: Mixture) -> None:
        assert len(mixture) > 1, "one Gaussian only"
        super().__init__(self._propose, ndim=mixture.means.shape[1])
        self._mixture = mixture

    def _propose(
        self, x: Float[Array, "W N"], rng: Random
    ) -> tuple[Float[Array, "W N"], Float[Array, "W"]]:
        mixture, rows = self._mixture, np.arange(len(x))
        before = mixture.log_share(x)
        old = mixture.draw_component(before, rng)
        new = (old + rng.randint(1, len(mixture), size=len(x))) % len(mixture)
        there = mixture.coloured(mixture.white(x, old), new)
        factor = mixture.log_volumes[new] - mixture.log_volumes[old]
        return there, factor + mixture.log_share(there)[rows, new] - before[rows, old]
