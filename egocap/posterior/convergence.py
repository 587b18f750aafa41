"""Convergence diagnostics of chains: rank-normalised split R-hat, bulk and tail effective draws.

Source: Vehtari, Gelman, Simpson, Carpenter & Buerkner 2021, "Rank-normalization, folding, and
localization: an improved R-hat for assessing convergence of MCMC"; Geyer 1992 (initial monotone
sequence). The numbers are those of ArviZ and of Stan's posterior package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

RHAT = 1.01
"""Limit of the rank-normalised split R-hat."""
_TAILS = (0.05, 0.95)


@dataclass(frozen=True)
class Health:
    """Convergence diagnostics of the kept part of a chain, one value a parameter."""

    rhat: Float[Array, "N"]  # larger of those of the ranks and of the ranks of distances
    effective: Float[Array, "N"]  # draws, in the bulk
    tail_effective: Float[Array, "N"]  # draws, for the 5 and 95 % quantiles

    def failure(self, names: tuple[str, ...], effective: float) -> str:
        """Why the chain has not converged, with the numbers; empty when it has."""
        apart = int(np.argmax(self.rhat))
        if not self.rhat[apart] <= RHAT:
            return (f"not converged: walkers disagree about {names[apart]}, "
                    f"R-hat {self.rhat[apart]:.3f} above {RHAT}")  # fmt: skip
        least = np.minimum(self.effective, self.tail_effective)
        fewest = int(np.argmin(least))
        if not least[fewest] >= effective:
            return (f"not converged: {least[fewest]:.0f} effective draws of {names[fewest]}, "
                    f"{effective:.0f} are needed")  # fmt: skip
        return ""


def examine(chain: Float[Array, "S W N"]) -> Health:
    """Diagnostics of W chains of S draws of N parameters."""
    parts = [chain[:, :, i] for i in range(chain.shape[2])]
    return Health(
        rhat=np.array([rank_rhat(x) for x in parts]),
        effective=np.array([bulk_effective(x) for x in parts]),
        tail_effective=np.array([tail_effective(x) for x in parts]),
    )


def rank_rhat(x: Float[Array, "S W"]) -> float:
    """Rank-normalised split R-hat of W chains of S draws, bulk or folded, whichever is larger."""
    halves = _split(x)
    return max(_rhat(_normal_scores(halves)), _rhat(_normal_scores(abs(halves - np.median(x)))))


def bulk_effective(x: Float[Array, "S W"]) -> float:
    """Effective draws of the rank-normalised split chains."""
    return effective_draws(_normal_scores(_split(x)))


def tail_effective(x: Float[Array, "S W"]) -> float:
    """Effective draws for the 5 and the 95 % quantile, the fewer of both."""
    return min(effective_draws(_split(x <= q).astype(float)) for q in np.quantile(x, _TAILS))


def effective_draws(x: Float[Array, "S W"]) -> float:
    """Effective draws of the mean over W chains of S draws; 0 when nothing moved.

    Autocorrelations over all chains are summed in pairs of lags as long as these are positive, none
    counted above the one before.
    """
    draws, chains = x.shape
    if not np.ptp(x, axis=0).any():
        return 0.0
    within = x.var(axis=0, ddof=1).mean()
    total = (draws - 1) / draws * within + x.mean(axis=0).var(ddof=1)
    rho = 1.0 - (within - _autocovariance(x).mean(axis=1)) / total
    rho[0] = 1.0
    pairs = rho[: draws - draws % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs[:-1] < 0.0)
    last = int(negative[0]) if len(negative) else len(pairs) - 1
    tau = -1.0 + 2.0 * np.minimum.accumulate(pairs[:last]).sum() + max(rho[2 * last], 0.0)
    # Alternating chains can do better than independent draws; the bound is Stan's.
    return chains * draws / max(tau, 1.0 / np.log10(chains * draws))


def _split(x: Array) -> Array:
    half = len(x) // 2
    return np.concatenate([x[:half], x[-half:]], axis=1)


def _normal_scores(x: Float[Array, "S W"]) -> Float[Array, "S W"]:
    from scipy.special import ndtri
    from scipy.stats import rankdata

    return ndtri((rankdata(x).reshape(x.shape) - 0.375) / (x.size + 0.25))


def _rhat(x: Float[Array, "S W"]) -> float:
    """Infinite when nothing moved within chains."""
    if not np.ptp(x, axis=0).any():
        return np.inf
    within, between = x.var(axis=0, ddof=1).mean(), x.mean(axis=0).var(ddof=1)
    return float(np.sqrt((len(x) - 1) / len(x) + between / within))


def _autocovariance(x: Float[Array, "S W"]) -> Float[Array, "S W"]:
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(2 * len(x))
    spectrum = np.asarray(rfft(x - x.mean(axis=0), size, axis=0))
    return np.asarray(irfft(np.abs(spectrum) ** 2, size, axis=0))[: len(x)] / len(x)
