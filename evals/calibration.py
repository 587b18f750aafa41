"""Whether the posterior's regions hold what they claim: coverage and rank statistics.

Well-specified: poses from the prior, detections from the likelihood, so that any failure is the
sampler's. Then detections from elsewhere against the truth of their sequences: there the likelihood
is wrong by an unknown amount, and one number, the temperature, is fitted to frames that are not
scored.

A joint's region of level p is the ellipsoid about the mean of one half of the walkers, in the
metric of their covariance, that holds a share p of the other half's draws.

Source: Talts et al. 2018 (simulation-based calibration); Guo et al. 2017 (temperature).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.cli import detections_from
from egocap.commandline import progress
from egocap.errors import InputError
from egocap.evaluate.table import Table, number
from egocap.labels import EVALUATED, LABELS
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.results import Detections
from egocap.rig import Rig
from egocap.sequence import open_sequence
from egocap.skeleton import DOFS
from evals.study import Outcome

LEVELS = (0.5, 0.8, 0.95)
TOLERANCE = 0.03
"""How far coverage may be from nominal in the well-specified study."""
STEPS = 2000
"""Of every frame's chain: about twenty autocorrelation times, a third of them burn-in."""
RANK_BINS = 12
TEMPERATURES = tuple(float(t) for t in np.geomspace(0.25, 64.0, 25))
CURVE = tuple(float(p) for p in np.linspace(0.05, 0.95, 19))


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


@dataclass(frozen=True)
class Job:
    """One frame to sample."""

    detections: Detections  # one frame
    joints: Float[Array, "18 3"]  # true, head frame
    angles: Float[Array, "37"] | None  # true, where the skeleton is the tracker's own
    rig: Rig
    proportions: Proportions
    config: PosteriorConfig
    seed: int


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
        told: dict[str, Any] = {"frames": len(self.scores), "levels": {}}
        for level in LEVELS:
            share, error = self.pooled(level)
            joints = zip(EVALUATED, self.per_joint(level), strict=True)
            told["levels"][f"{level:g}"] = {
                "coverage": round(share, 4),
                "standard_error": round(error, 4),
                "laplace_coverage": round(self.pooled(level, laplace=True)[0], 4),
                "per_joint": {LABELS[j]: round(float(c), 4) for j, c in joints},
                "binomial_error": round(self.binomial_error(level), 4),
            }
        joints_only = list(EVALUATED)
        told["rms_error_mm"] = round(
            float(np.sqrt(np.mean([s.error_mm[joints_only] ** 2 for s in self.scores]))), 2
        )
        told["rms_expected_mm"] = round(
            float(np.sqrt(np.mean([s.spread_mm[joints_only] ** 2 for s in self.scores]))), 2
        )
        told["median_effective"] = round(float(np.median([s.effective for s in self.scores])))
        told["least_effective"] = round(min(s.effective for s in self.scores))
        told["largest_rhat"] = round(max(s.rhat for s in self.scores), 3)
        return told


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """The well-specified study, and, where there are detections, before and after temperature."""

    well_specified: Coverage | None
    before: Coverage | None = None
    after: Coverage | None = None
    temperature: float | None = None
    settings: dict[str, Any] | None = None

    def missed(self) -> list[str]:
        """Levels at which the well-specified coverage is off, in words."""
        missed = []
        if self.well_specified is None:
            return missed
        for level in LEVELS:
            share, _ = self.well_specified.pooled(level)
            if abs(share - level) > TOLERANCE:
                missed.append(f"coverage {100 * share:.1f} % at {100 * level:.0f} %")
        return missed

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        told: dict[str, Any] = {"settings": self.settings, "missed": self.missed()}
        if self.well_specified is not None:
            told["well_specified"] = self.well_specified.to_dict() | {
                "ranks": rank_statistics(self.well_specified.scores)
            }
        if self.before is not None and self.after is not None:
            told["temperature"] = self.temperature
            told["before"], told["after"] = self.before.to_dict(), self.after.to_dict()
        return told

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
            rows.append((coverage.name, str(len(coverage.scores)), *cells, " ".join(laplace)))
        header = ("study", "frames", "50 %", "80 %", "95 %", "Laplace")
        return Table("Share of true joints in the posterior's regions, %", header, tuple(rows))


def run_well_specified(
    frames: int, rig: Rig, *, sigma: float, missing: float, degrees: float, seed: int, workers: int
) -> CalibrationReport:
    """Draw a pose and its detections `frames` times, sample each, see where the truth lies.

    Every view misses a joint with chance `missing`, whatever the pose. Raises InputError.
    """
    from egocap.posterior.simulation import draw_detections, draw_poses
    from egocap.skeleton import forward

    if frames < 2:
        raise InputError(f"{frames} frames", valid="2 or more")
    if not 0.0 <= missing <= 1.0:
        raise InputError(f"missing = {missing}", valid="0 to 1")
    config = PosteriorConfig(degrees=degrees, model_error_m=0.0)
    rng = np.random.default_rng(seed)
    person = Proportions.from_lengths(1.75)
    poses = draw_poses(frames, config, rng)
    seen = rng.random((frames, len(rig.mounts), len(LABELS))) >= missing
    found = draw_detections(poses, seen, rig, person, sigma, config, rng)
    joints = forward(person, poses)
    jobs = [
        Job(one_frame(found, i), joints[i], poses[i], rig, person, config, seed + i)
        for i in range(frames)
    ]
    scores = score_all(jobs, workers, "well-specified")
    settings = {"rig": rig.name, "sigma_px": sigma, "missing": missing, "steps": STEPS,
                "degrees": degrees if np.isfinite(degrees) else "inf", "seed": seed}  # fmt: skip
    return CalibrationReport(Coverage("well-specified", scores), settings=settings)


def run_detector(
    folders: Sequence[Path], source: str, frames: int, config: PosteriorConfig, workers: int
) -> tuple[Coverage, Coverage, float]:
    """Coverage on sequences with some detections, before and after a held-out temperature.

    Frames are spread evenly. Of several sequences every other one is held out for the temperature;
    of one, its first half. Raises InputError, FileError.
    """
    jobs = [_jobs_of(folder, source, frames, config) for folder in folders]
    if len(jobs) == 1:
        half = len(jobs[0]) // 2
        fitting, scored = jobs[0][:half], jobs[0][half:]
    else:
        fitting = [job for part in jobs[::2] for job in part]
        scored = [job for part in jobs[1::2] for job in part]
    if min(len(fitting), len(scored)) < 2:
        raise InputError(f"{frames} frames a sequence are too few to hold some out", valid="4 up")
    temperature = fit_temperature(fitting)
    before = score_all(scored, workers, "before")
    warm = [replace(j, config=replace(j.config, temperature=temperature)) for j in scored]
    after = score_all(warm, workers, "after")
    return Coverage("as stated", before), Coverage("recalibrated", after), temperature


def fit_temperature(jobs: Sequence[Job]) -> float:
    """The temperature at which Laplace's regions come closest to their nominal shares."""

    def off(temperature: float) -> float:
        inside = np.array([
            _laplace_inside(replace(job, config=replace(job.config, temperature=temperature)))
            for job in jobs
        ])[:, list(EVALUATED)]  # fmt: skip
        return float(sum(abs((inside <= level).mean() - level) for level in LEVELS))

    return min(TEMPERATURES, key=off)


def score_all(jobs: Sequence[Job], workers: int, what: str) -> tuple[FrameScore, ...]:
    """Sample every job's frame, in processes of their own when there is more than one worker."""
    with progress(what, len(jobs)) as advance:
        return tuple(_counted(_mapped(score_frame, jobs, workers), advance))


def score_frame(job: Job) -> FrameScore:
    """Sample one frame and place the truth in its posterior."""
    from egocap.posterior.laplace import find_modes
    from egocap.posterior.log_prob import log_posterior_of
    from egocap.posterior.sampler import sample

    density = log_posterior_of(job.detections, 0, job.rig, job.proportions, job.config)
    result = sample(density, SamplerConfig(most_steps=STEPS, seed=job.seed))
    inside = region_share(result.joints, job.joints)
    mode = find_modes(density, np.random.default_rng(job.seed))[0]
    away = job.joints - density.joints(mode.mean[None])[0]
    ranks = None
    if job.angles is not None:
        last = result.draws[:, -1, : len(DOFS)]  # walkers are independent of each other
        ranks = (last < job.angles).mean(0)
    centre = result.joint_mean
    return FrameScore(
        inside=inside,
        laplace=_gaussian_share(away, result.laplace_joints),
        ranks=ranks,
        error_mm=1e3 * np.linalg.norm(centre - job.joints, axis=-1),
        spread_mm=1e3 * np.sqrt(np.trace(result.joint_covariance, axis1=1, axis2=2)),
        effective=float(result.effective.min()),
        rhat=float(result.rhat.max()),
    )


def region_share(
    joints: Float[Array, "W S 18 3"], truth: Float[Array, "18 3"]
) -> Float[Array, "18"]:
    """Share of one half of the walkers' draws that lie nearer to the other half's mean, in its
    metric, than the truth does. Uniform on [0, 1] when the draws and the truth are alike."""
    half = len(joints) // 2
    shape, judged = joints[:half].reshape(-1, 18, 3), joints[half:].reshape(-1, 18, 3)
    centre = shape.mean(0)
    away = shape - centre
    covariance = np.einsum("bji,bjk->jik", away, away) / len(away) + 1e-14 * np.eye(3)
    metric = np.linalg.inv(covariance)
    distance = np.einsum("bji,jik,bjk->bj", judged - centre, metric, judged - centre)
    true = np.einsum("ji,jik,jk->j", truth - centre, metric, truth - centre)
    return (distance < true).mean(0)


def rank_statistics(scores: Iterable[FrameScore]) -> dict[str, Any]:
    """Chi-squared of every angle's ranks in bins; p values are even when the sampler is right."""
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


def write_diagram(path: Path, report: CalibrationReport) -> None:
    """The reliability diagram and the rank histogram as an HTML page."""
    from egocap.posterior.page import write_pictures
    from egocap.posterior.pictures import draw_reliability

    studies = [c for c in (report.well_specified, report.before, report.after) if c is not None]
    figure = draw_reliability({c.name: c.curve() for c in studies})
    facts = "; ".join(report.missed()) or "well-specified coverage is within tolerance"
    write_pictures(path, "Calibration of the posterior", [("Reliability", figure)], facts=facts)


def one_frame(detections: Detections, frame: int) -> Detections:
    """A file's worth of detections with one frame."""
    names = ("times", "points", "sigma", "confidence", "valid")
    part = {name: getattr(detections, name)[frame : frame + 1] for name in names}
    return replace(detections, **part)


def _jobs_of(folder: Path, source: str, frames: int, config: PosteriorConfig) -> list[Job]:
    sequence = open_sequence(folder)
    found = detections_from(sequence, source, 0)
    chosen = np.unique(np.linspace(0, len(sequence) - 1, min(frames, len(sequence))).astype(int))
    truth = sequence.truth.joints_head
    return [
        Job(one_frame(found, i), truth[i], None, sequence.rig, sequence.proportions, config, int(i))
        for i in chosen
    ]


def _laplace_inside(job: Job) -> Float[Array, "18"]:
    from egocap.posterior.laplace import find_modes
    from egocap.posterior.log_prob import log_posterior_of
    from egocap.posterior.sampler import laplace_joints

    density = log_posterior_of(job.detections, 0, job.rig, job.proportions, job.config)
    mode = find_modes(density, np.random.default_rng(job.seed))[0]
    away = job.joints - density.joints(mode.mean[None])[0]
    return _gaussian_share(away, laplace_joints(density, mode))


def _gaussian_share(
    away: Float[Array, "18 3"], covariance: Float[Array, "18 3 3"]
) -> Float[Array, "18"]:
    from scipy.stats import chi2

    metric = np.linalg.inv(covariance + 1e-14 * np.eye(3))
    return chi2.cdf(np.einsum("ji,jik,jk->j", away, metric, away), 3)


def _bin_counts(ranks: Float[Array, "B 37"]) -> Int[Array, "37 K"]:
    # A rank is k / W: a hair to the right puts the W + 1 values evenly into the bins.
    binned = np.minimum((ranks * RANK_BINS + 1e-9).astype(int), RANK_BINS - 1)
    return np.array([np.bincount(column, minlength=RANK_BINS) for column in binned.T])


def _counted(results: Iterable[FrameScore], advance: Callable[..., None]) -> Iterable[FrameScore]:
    for result in results:
        advance()
        yield result


def _mapped(
    function: Callable[[Job], FrameScore], jobs: Sequence[Job], workers: int
) -> Iterable[FrameScore]:
    if workers < 2:
        yield from map(function, jobs)
        return
    # Read when a worker imports numba and BLAS: one thread a process.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(function, jobs)


def study(
    sequences: tuple[Path, ...] = (),
    /,
    frames: int = 300,
    detections: str = "learned",
    sigma: float = 2.0,
    missing: float = 0.3,
    degrees: float = 5.0,
    rig: Path | None = None,
    seed: int = 0,
    workers: int = 2,
    only_detector: bool = False,
    page: Path | None = None,
) -> Outcome:
    """Coverage and rank statistics of the posterior, well-specified and on sequences.

    Args:
        sequences: Sequences on which to score some detections, before and after a temperature.
        frames: Frames of the well-specified study, and of each sequence.
        detections: Detections of the sequences, as for `egocap track`.
        sigma: Spread of well-specified detections, pixels at a width of 640.
        missing: Chance that a view misses a joint.
        degrees: Degrees of freedom of Student-t errors; inf: Gaussian.
        rig: Rig file; EgoRig1 by default.
        seed: Of poses, noise and chains.
        workers: Processes.
        only_detector: Leave the well-specified study out.
        page: Reliability diagram to write, html.
    """
    from egocap.rig import load_rig
    from egocap_sim.builtin import rig_file

    if workers < 1:
        raise InputError(f"{workers} workers", valid="1 or more")
    if only_detector and not sequences:
        raise InputError("--only-detector without sequences", valid="folders of sequences")
    report = CalibrationReport(None)
    if not only_detector:
        camera = load_rig(rig or rig_file("egorig1")).resized(640, 512)
        report = run_well_specified(
            frames, camera, sigma=sigma, missing=missing, degrees=degrees, seed=seed,
            workers=workers,
        )  # fmt: skip
    if sequences:
        config = PosteriorConfig(degrees=degrees)
        found = run_detector(sequences, detections, frames, config, workers)
        report = replace(report, before=found[0], after=found[1], temperature=found[2])
    if page is not None:
        write_diagram(page, report)
    return Outcome(report.to_dict(), (report.to_table(),), report.missed())
