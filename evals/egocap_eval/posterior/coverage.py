"""Coverage of posterior regions by the truth, and rank statistics.

A joint's region of level p is the ellipsoid about the mean of one half of the walkers, in the
metric of their covariance, that holds a share p of the other half's draws.

Source: Talts et al. 2018, "Validating Bayesian inference algorithms with simulation-based
calibration".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.labels import EVALUATED, LABELS
from egocap.body.skeleton import DOFS
from egocap.evaluation.table import Table, number
from egocap.posterior.detector_error import DetectorError

LEVELS = (0.5, 0.8, 0.95)
CURVE = tuple(float(p) for p in np.linspace(0.05, 0.95, 19))
RANK_BINS = 12
TOLERANCE = 0.03
"""How far coverage may be from nominal."""


@dataclass(frozen=True, eq=False)
class FrameScore:
    """Where the truth of one frame lies in its posterior."""

    inside: Float[Array, "18"]  # share of draws nearer to the centre than the true joint
    laplace: Float[Array, "18"]  # the same by the Gaussian about the mode
    ranks: Float[Array, "37"] | None  # share of independent draws below the true angle
    error_mm: Float[Array, "18"]  # posterior mean from the truth
    spread_mm: Float[Array, "18"]  # root mean square the posterior expects
    effective: float  # least effective number of draws
    rhat: float
    converged: bool

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}

    @classmethod
    def from_dict(cls, result: dict[str, Any]) -> FrameScore:
        """The inverse of `to_dict`. Raises TypeError for other fields."""
        values: dict[str, Any] = {
            k: np.array(v) if isinstance(v, list) else v for k, v in result.items()
        }
        return cls(**values)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Scores of many frames under one name."""

    name: str
    scores: tuple[FrameScore, ...]

    def inside(self, laplace: bool = False) -> Float[Array, "B 17"]:
        """Of every frame and evaluated joint."""
        rows = [score.laplace if laplace else score.inside for score in self.scores]
        return np.array(rows)[:, list(EVALUATED)]

    def pooled(self, level: float, laplace: bool = False) -> tuple[float, float]:
        """Coverage over joints and frames, and its standard error: frames are independent, the
        joints of a frame are not."""
        hits = (self.inside(laplace) <= level).mean(axis=1)
        return float(hits.mean()), float(hits.std(ddof=1) / np.sqrt(len(hits)))

    def per_joint(self, level: float) -> Float[Array, "17"]:
        """Coverage of every evaluated joint; the binomial error is `binomial_error`."""
        return (self.inside() <= level).mean(axis=0)

    def binomial_error(self, level: float) -> float:
        """Standard error of one joint's coverage."""
        return float(np.sqrt(level * (1.0 - level) / len(self.scores)))

    def curve(self) -> tuple[Float[Array, "L"], Float[Array, "L"], Float[Array, "L"]]:
        """Nominal levels, coverages, and 95 % error bars, for the reliability diagram."""
        found = np.array([self.pooled(level) for level in CURVE])
        return np.array(CURVE), found[:, 0], 1.96 * found[:, 1]

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        result: dict[str, Any] = {"frames": len(self.scores), "levels": {}}
        for level in LEVELS:
            share, error = self.pooled(level)
            joints = zip(EVALUATED, self.per_joint(level), strict=True)
            result["levels"][f"{level:g}"] = {
                "coverage": round(share, 4),
                "standard_error": round(error, 4),
                "laplace_coverage": round(self.pooled(level, laplace=True)[0], 4),
                "per_joint": {LABELS[j]: round(float(c), 4) for j, c in joints},
                "binomial_error": round(self.binomial_error(level), 4),
            }
        result["rms_error_mm"] = round(self._rms("error_mm"), 2)
        result["rms_expected_mm"] = round(self._rms("spread_mm"), 2)
        result["median_effective"] = round(float(np.median([s.effective for s in self.scores])))
        result["least_effective"] = round(min(s.effective for s in self.scores))
        result["largest_rhat"] = round(max(s.rhat for s in self.scores), 4)
        result["not_converged"] = sum(not s.converged for s in self.scores)
        return result

    def _rms(self, name: str) -> float:
        rows = np.array([getattr(score, name) for score in self.scores])[:, list(EVALUATED)]
        return float(np.sqrt(np.mean(rows**2)))


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """The well-specified study and, of a detector, those without and with the error model."""

    well_specified: Coverage | None
    before: Coverage | None = None
    after: Coverage | None = None
    model: DetectorError | None = None
    settings: dict[str, Any] | None = None

    def missed(self) -> list[str]:
        """Levels at which coverage is off, and chains that did not converge, in words."""
        missed = []
        for study in filter(None, (self.well_specified, self.after)):
            for level in LEVELS:
                share, _ = study.pooled(level)
                if abs(share - level) > TOLERANCE:
                    missed.append(f"{study.name}: {100 * share:.1f} % in regions of {level:.0%}")
            if lost := sum(not score.converged for score in study.scores):
                missed.append(f"{study.name}: {lost} of {len(study.scores)} chains not converged")
        return missed

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        result: dict[str, Any] = {"settings": self.settings, "missed": self.missed()}
        if self.well_specified is not None:
            result["well_specified"] = self.well_specified.to_dict() | {
                "ranks": rank_statistics(self.well_specified.scores)
            }
        if self.before is not None and self.after is not None and self.model is not None:
            result["error_model"] = asdict(self.model)
            result["before"], result["after"] = self.before.to_dict(), self.after.to_dict()
        return result

    def to_table(self) -> Table:
        """Coverage at every level, in percent."""
        rows = []
        for coverage in (self.well_specified, self.before, self.after):
            if coverage is None:
                continue
            cells = []
            for level in LEVELS:
                share, error = coverage.pooled(level)
                cells.append(f"{100 * share:.1f} +- {100 * error:.1f}")
            laplace = [number(100 * coverage.pooled(level, laplace=True)[0]) for level in LEVELS]
            lost = sum(not score.converged for score in coverage.scores)
            frames = str(len(coverage.scores))
            rows.append((coverage.name, frames, str(lost), *cells, " ".join(laplace)))
        header = ("study", "frames", "not converged", "50 %", "80 %", "95 %", "Laplace")
        return Table("Share of true joints in the posterior's regions, %", header, tuple(rows))


def region_share(
    joints: Float[Array, "W S 18 3"], truth: Float[Array, "18 3"]
) -> Float[Array, "18"]:
    """Share of one half of the walkers' draws that lie nearer to the other half's mean, in its
    metric, than the truth does. Uniform on [0, 1] for a correct sampler."""
    half = len(joints) // 2
    shape, judged = joints[:half].reshape(-1, 18, 3), joints[half:].reshape(-1, 18, 3)
    centre = shape.mean(0)
    away = shape - centre
    covariance = np.einsum("bji,bjk->jik", away, away) / len(away) + 1e-14 * np.eye(3)
    metric = np.linalg.inv(covariance)
    distance = np.einsum("bji,jik,bjk->bj", judged - centre, metric, judged - centre)
    true = np.einsum("ji,jik,jk->j", truth - centre, metric, truth - centre)
    return (distance < true).mean(0)


def gaussian_share(
    away: Float[Array, "18 3"], covariance: Float[Array, "18 3 3"]
) -> Float[Array, "18"]:
    """Share of a Gaussian that lies nearer to its centre than points `away` from it."""
    from scipy.stats import chi2

    metric = np.linalg.inv(covariance + 1e-14 * np.eye(3))
    return chi2.cdf(np.einsum("ji,jik,jk->j", away, metric, away), 3)


def rank_statistics(scores: Iterable[FrameScore]) -> dict[str, Any]:
    """Chi-squared tests of every angle's ranks; p values of a correct sampler are uniform."""
    from scipy.stats import chi2, kstest

    ranks = np.array([score.ranks for score in scores if score.ranks is not None])
    counts = _bin_counts(ranks)
    expected = len(ranks) / RANK_BINS
    statistic = np.sum((counts - expected) ** 2 / expected, axis=1)
    p = chi2.sf(statistic, RANK_BINS - 1)
    return {
        "bins": RANK_BINS,
        "p_values": {name: round(float(v), 4) for name, v in zip(DOFS, p, strict=True)},
        "smallest_p": round(float(p.min()), 5),
        "smallest_p_of_as_many": round(float(1.0 - (1.0 - p.min()) ** len(p)), 4),
        "evenness_of_p": round(float(kstest(p, "uniform").pvalue), 4),
        "mean_rank": round(float(ranks.mean()), 4),
        "histogram": counts.sum(0).tolist(),
    }


def _bin_counts(ranks: Float[Array, "B 37"]) -> Int[Array, "37 K"]:
    # A rank is k / W: a hair to the right puts the W + 1 values evenly into the bins.
    binned = np.minimum((ranks * RANK_BINS + 1e-9).astype(int), RANK_BINS - 1)
    return np.array([np.bincount(column, minlength=RANK_BINS) for column in binned.T])
