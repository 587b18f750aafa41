"""Calibration of the posterior: coverage of its credible regions and rank statistics.

Well-specified: poses are drawn from the prior and detections from the likelihood, so that any
failure is the sampler's. On sequences the detector's errors are not the likelihood's; a model of
them (`egocap.posterior.detector_error`) is learned from sequences that are not scored. `coverage`
has the measures.

Source: Talts et al. 2018 (simulation-based calibration).
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

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOFS, forward
from egocap.cameras.rig import Rig
from egocap.commandline import progress
from egocap.data.detections import Detections
from egocap.data.sequence import Sequence as Footage
from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.detector_error import DetectorError, learn_detector_error
from egocap.posterior.information import Noise, image_sensitivity, prior_information
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.sampler import sample
from egocap.posterior.synthetic_pose import draw_detections, draw_poses
from egocap_eval.harness.cases import ScoreLog, map_in_processes
from egocap_eval.harness.study import Outcome
from egocap_eval.posterior.calibration_plots import write_diagrams
from egocap_eval.posterior.coverage import (
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
POSES = 3
"""Poses of every sequence at which the correlation of errors is weighed."""


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
) -> tuple[Coverage, Coverage, DetectorError]:
    """Coverage on sequences with some detections: as stated, and by a model of their errors.

    The model is learned from every other sequence; the frames of the others are scored, spread
    evenly. Raises InputError, FileError.
    """
    if len(folders) < 2:
        raise InputError(
            f"{len(folders)} sequences", valid="2 or more: half teach, half are scored"
        )
    sequences = [open_sequence(folder) for folder in folders]
    found = [detections_from(sequence, source, 0) for sequence in sequences]
    model = learn_errors(sequences[::2], found[::2])
    scored = list(zip(sequences[1::2], found[1::2], strict=True))
    before = score_all(_jobs(scored, frames, config), workers, "as stated", log)
    corrected = [(sequence, model.correct(part)) for sequence, part in scored]
    jobs = _jobs(corrected, frames, model.configure(config))
    after = score_all(jobs, workers, "by the error model", log)
    return Coverage("as stated", before), Coverage("by the error model", after), model


def learn_errors(footage: Sequence[Footage], found: Sequence[Detections]) -> DetectorError:
    """The model of the errors of some sequences' detections."""
    from egocap_eval.priors.takes import fit_angles

    sensitivity = []
    for sequence, part in zip(footage, found, strict=True):
        rows = np.linspace(0, len(sequence) - 1, POSES).astype(int)
        angles = fit_angles(sequence.truth.joints_head[rows], sequence.body)
        sensitivity.append(
            image_sensitivity(angles, sequence.body, sequence.rig, part.valid[rows], Noise(),
                              part.sigma[rows])
        )  # fmt: skip
    return learn_detector_error(
        found, [s.truth.joints_2d for s in footage], np.concatenate(sensitivity),
        prior_information(np.zeros((1, len(DOFS))))[0],
    )  # fmt: skip


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


def _jobs(
    footage: Sequence[tuple[Footage, Detections]], frames: int, config: PosteriorConfig
) -> list[Job]:
    jobs = []
    for sequence, found in footage:
        chosen = np.linspace(0, len(sequence) - 1, min(frames, len(sequence))).astype(int)
        truth = sequence.truth.joints_head
        jobs += [
            Job(found[i : i + 1], truth[i], None, sequence.rig, sequence.body, config, int(i))
            for i in np.unique(chosen)
        ]
    return jobs


def study(
    sequences: tuple[Path, ...] = (),
    /,
    frames: int = 160,
    frames_each: int = 6,
    detections: str = "learned",
    noise: Annotated[DrawnNoise, OmitArgPrefixes] = DrawnNoise(),
    rig: Path | None = None,
    seed: int = 0,
    workers: int = 2,
    only_detector: bool = False,
    keep: Path | None = None,
    page: Path | None = None,
    model: Path | None = None,
) -> Outcome:
    """Measure coverage and rank statistics of the posterior, well-specified and on sequences.

    Args:
        sequences: Sequences with truth; from every other one a model of the detector's errors is
            learned, the others are scored.
        frames: Number of frames of the well-specified study.
        frames_each: Number of frames of each sequence that is scored.
        detections: Detections of the sequences, as for `egocap track`.
        noise: Noise of the well-specified detections.
        rig: Rig file; EgoRig1 by default.
        seed: Seed of poses, noise and chains.
        workers: Number of processes.
        only_detector: Skip the well-specified study.
        keep: Finished scores; the same command continues from them after a stop.
        page: HTML page of figures to write.
        model: Model of the detector's errors to write, json.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap_sim.core.resources import rig_file

    if workers < 1:
        raise InputError(f"{workers} workers", valid="1 or more")
    if model is not None and not sequences:
        raise InputError("--model without sequences", valid="folders of sequences")
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
        before, after, learned = run_detector(
            sequences, detections, frames_each, config, workers, log
        )
        report = replace(report, before=before, after=after, model=learned)
        if model is not None:
            learned.save(model)
    if page is not None:
        write_diagrams(page, report)
    return Outcome(report.to_dict(), (report.to_table(),), report.missed())
