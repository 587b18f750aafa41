"""Calibration of the posterior: coverage of its credible regions and rank statistics.

Well-specified: poses are drawn from the prior and detections from the likelihood, so that any
failure is the sampler's. On sequences the likelihood is wrong by an unknown amount; one number, the
temperature, is fitted to frames that are not scored. `coverage` has the measures.

Source: Talts et al. 2018 (simulation-based calibration); Guo et al. 2017 (temperature).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import OmitArgPrefixes

from egocap.body.labels import EVALUATED, LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOFS, forward
from egocap.cameras.rig import Rig
from egocap.commandline import progress
from egocap.data.detections import Detections
from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.laplace import find_modes
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.sampler import laplace_joints, sample
from egocap.posterior.synthetic_pose import draw_detections, draw_poses
from egocap_eval.harness.cases import ScoreLog, map_in_processes
from egocap_eval.harness.study import Outcome
from egocap_eval.posterior.calibration_plots import write_diagrams
from egocap_eval.posterior.coverage import (
    LEVELS,
    CalibrationReport,
    Coverage,
    FrameScore,
    gaussian_share,
    region_share,
)

SAMPLER = SamplerConfig(most_steps=8000)
"""Limit of every frame's chain; what has not converged by then is scored and counted."""
DRAWS_A_WALKER = 12
"""Draws of every walker that a rank is taken among, far enough apart to be independent."""
THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
TEMPERATURES = tuple(float(t) for t in np.geomspace(0.25, 64.0, 25))


@dataclass(frozen=True)
class DrawnNoise:
    """Noise of the detections drawn in the well-specified study."""

    sigma: float = 2.0
    """Spread of the detections, pixels at a width of 640."""
    missing: float = 0.3
    """Probability that a view misses a joint, whatever the pose."""
    degrees: float = 5.0
    """Degrees of freedom of the Student-t errors, also on sequences; inf: Gaussian."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.missing <= 1.0:
            raise InputError(f"missing = {self.missing}", valid="0 to 1")


@dataclass(frozen=True, eq=False)
class Job:
    """One frame to sample."""

    detections: Detections  # one frame
    joints: Float[Array, "18 3"]  # true, head frame
    angles: Float[Array, "37"] | None  # true, where the skeleton is the tracker's own
    rig: Rig
    proportions: Proportions
    config: PosteriorConfig
    seed: int

    @property
    def key(self) -> str:
        """Hash of everything that the score depends on."""
        found, digest = self.detections, hashlib.sha256()
        for array in (found.points, found.sigma, found.confidence, found.valid, self.joints,
                      self.angles, self.proportions.offsets):  # fmt: skip
            digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
        text = [asdict(self.config), self.rig.to_dict(), self.seed, asdict(SAMPLER)]
        digest.update(json.dumps(text, sort_keys=True).encode())
        return digest.hexdigest()[:32]


def run_well_specified(
    frames: int,
    rig: Rig,
    noise: DrawnNoise,
    *,
    seed: int,
    workers: int,
    log: ScoreLog | None = None,
) -> CalibrationReport:
    """Draw `frames` poses and their detections, sample each posterior, rank the truth in it.

    Raises InputError.
    """
    if frames < 2:
        raise InputError(f"{frames} frames", valid="2 or more")
    config = PosteriorConfig(degrees=noise.degrees, model_error_m=0.0)
    rng = np.random.default_rng(seed)
    person = Proportions.from_lengths(1.75)
    poses = draw_poses(frames, config, rng)
    seen = rng.random((frames, len(rig.mounts), len(LABELS))) >= noise.missing
    found = draw_detections(poses, seen, rig, person, noise.sigma, config, rng)
    joints = forward(person, poses)
    jobs = [
        Job(found[i : i + 1], joints[i], poses[i], rig, person, config, seed + i)
        for i in range(frames)
    ]
    scores = score_all(jobs, workers, "well-specified", log)
    settings = {"rig": rig.name, "sigma_px": noise.sigma, "missing": noise.missing,
                "most_steps": SAMPLER.most_steps, "seed": seed,
                "degrees": noise.degrees if np.isfinite(noise.degrees) else "inf"}  # fmt: skip
    return CalibrationReport(Coverage("well-specified", scores), settings=settings)


def run_detector(
    folders: Sequence[Path],
    source: str,
    frames: int,
    config: PosteriorConfig,
    workers: int,
    log: ScoreLog | None = None,
) -> tuple[Coverage, Coverage, float]:
    """Coverage on sequences with some detections, before and after a held-out temperature.

    Frames are spread evenly. Of several sequences every other one is held out for the temperature;
    of one, its first half. Raises InputError, FileError.
    """
    jobs = [_sequence_jobs(folder, source, frames, config) for folder in folders]
    if len(jobs) == 1:
        half = len(jobs[0]) // 2
        fitting, scored = jobs[0][:half], jobs[0][half:]
    else:
        fitting = [job for part in jobs[::2] for job in part]
        scored = [job for part in jobs[1::2] for job in part]
    if min(len(fitting), len(scored)) < 2:
        raise InputError(f"{frames} frames a sequence are too few to hold some out", valid="4 up")
    temperature = fit_temperature(fitting)
    before = score_all(scored, workers, "before", log)
    warm = [replace(j, config=replace(j.config, temperature=temperature)) for j in scored]
    after = score_all(warm, workers, "after", log)
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


def score_all(
    jobs: Sequence[Job], workers: int, what: str, log: ScoreLog | None = None
) -> tuple[FrameScore, ...]:
    """Sample every job's frame; scores in the log are reused."""
    log = log or ScoreLog()
    keys = [job.key for job in jobs]
    left = [(key, job) for key, job in zip(keys, jobs, strict=True) if key not in log]
    if workers > 1:  # read when a worker imports numba and BLAS: one thread per process
        os.environ |= dict.fromkeys(THREAD_COUNTS, "1")
    with progress(what, len(jobs)) as advance:
        advance(len(jobs) - len(left))
        found = map_in_processes(score_frame, [job for _, job in left], workers)
        for (key, _), score in zip(left, found, strict=True):
            log.add(key, score.to_dict())
            advance()
    return tuple(FrameScore.from_dict(log[key]) for key in keys)


def score_frame(job: Job) -> FrameScore:
    """Sample one frame and place the truth in its posterior."""
    density = make_log_posterior(job.detections, 0, job.rig, job.proportions, job.config)
    result = sample(density, replace(SAMPLER, seed=job.seed))
    away = job.joints - density.joints(result.modes[:1])[0]
    ranks = None
    if job.angles is not None:
        kept = result.draws.shape[1]
        rows = np.linspace(0, kept - 1, DRAWS_A_WALKER).astype(int)
        ranks = (result.draws[:, rows, : len(DOFS)] < job.angles).mean((0, 1))
    return FrameScore(
        inside=region_share(result.joints, job.joints),
        laplace=gaussian_share(away, result.laplace_joints),
        ranks=ranks,
        error_mm=1e3 * np.linalg.norm(result.joint_mean - job.joints, axis=-1),
        spread_mm=1e3 * np.sqrt(np.trace(result.joint_covariance, axis1=1, axis2=2)),
        effective=float(result.effective.min()),
        rhat=float(result.rhat.max()),
        converged=result.converged,
    )


def _sequence_jobs(folder: Path, source: str, frames: int, config: PosteriorConfig) -> list[Job]:
    sequence = open_sequence(folder)
    found = detections_from(sequence, source, 0)
    chosen = np.unique(np.linspace(0, len(sequence) - 1, min(frames, len(sequence))).astype(int))
    truth = sequence.truth.joints_head
    return [
        Job(found[i : i + 1], truth[i], None, sequence.rig, sequence.body, config, int(i))
        for i in chosen
    ]


def _laplace_inside(job: Job) -> Float[Array, "18"]:
    density = make_log_posterior(job.detections, 0, job.rig, job.proportions, job.config)
    mode = find_modes(density, np.random.default_rng(job.seed))[0]
    away = job.joints - density.joints(mode.mean[None])[0]
    return gaussian_share(away, laplace_joints(density, mode))


def study(
    sequences: tuple[Path, ...] = (),
    /,
    frames: int = 200,
    detections: str = "learned",
    noise: Annotated[DrawnNoise, OmitArgPrefixes] = DrawnNoise(),
    rig: Path | None = None,
    seed: int = 0,
    workers: int = 2,
    only_detector: bool = False,
    keep: Path | None = None,
    page: Path | None = None,
) -> Outcome:
    """Measure coverage and rank statistics of the posterior, well-specified and on sequences.

    Args:
        sequences: Sequences to score too, before and after fitting a temperature.
        frames: Number of frames of the well-specified study, and of each sequence.
        detections: Detections of the sequences, as for `egocap track`.
        noise: Noise of the well-specified detections.
        rig: Rig file; EgoRig1 by default.
        seed: Seed of poses, noise and chains.
        workers: Number of processes.
        only_detector: Skip the well-specified study.
        keep: Finished scores; the same command continues from them after a stop.
        page: HTML page of figures to write.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap_sim.core.resources import rig_file

    if workers < 1:
        raise InputError(f"{workers} workers", valid="1 or more")
    if only_detector and not sequences:
        raise InputError("--only-detector without sequences", valid="folders of sequences")
    log, report = ScoreLog(keep, check=FrameScore.from_dict), CalibrationReport(None)
    if not only_detector:
        camera = load_rig(rig or rig_file("egorig1")).resized(640, 512)
        report = run_well_specified(
            frames, camera, noise, seed=seed, workers=workers, log=log
        )  # fmt: skip
    if sequences:
        config = PosteriorConfig(degrees=noise.degrees)
        found = run_detector(sequences, detections, frames, config, workers, log)
        report = replace(report, before=found[0], after=found[1], temperature=found[2])
    if page is not None:
        write_diagrams(page, report)
    return Outcome(report.to_dict(), (report.to_table(),), report.missed())
