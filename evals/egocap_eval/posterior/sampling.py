"""Sampling speed of the posterior, and the tracker's error over the Cramer-Rao bound.

The bound is the Bayesian one given the whole sequence: detections of the stated noise where the
renderer says that a joint is seen, the tracker's posture prior and random accelerations. The
tracker's skeleton is not the person's, so its errors have a part that the bound excludes; the
distance of that skeleton's nearest pose is given beside it. Joints count in the frames in which a
view sees them. A Bayesian bound holds on average over motions drawn from the prior; for calmer
motions, such as walking, the ratio can be under 1.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

import egocap
from egocap.body.labels import EVALUATED, LABELS
from egocap.body.skeleton import forward
from egocap.commandline import progress
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.truth import VISIBLE
from egocap.detect.sources import detections_from
from egocap.detect.synthetic import parse_source
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap_eval.harness.footage import content_hashes
from egocap_eval.harness.study import Outcome

LEAST_RATE = 20_000.0
"""Evaluations a second to reach."""
MOST_OVER_BOUND = 1.5
"""Maximum ratio of tracker error to bound at the detector's own noise."""
LEAST_EFFECTIVE, MOST_SECONDS = 400.0, 20.0
"""Effective draws of every angle to reach in so many seconds a frame."""


def study(
    sequences: tuple[Path, ...],
    /,
    sigma: float = 2.0,
    seeds: int = 3,
    sampled: int = 5,
    learned: bool = False,
) -> Outcome:
    """Measure sampling speed, and the tracker's error over the Cramer-Rao bound per joint.

    Args:
        sequences: Folders of sequences.
        sigma: Spread of simulated detections, pixels at a width of 640.
        seeds: Draws of the detections' noise to track.
        sampled: Frames of every sequence to sample.
        learned: Also track detections of the shipped weights, with the bound at their noise.
    """
    if seeds < 1 or sampled < 0:
        raise InputError(f"{seeds} seeds, {sampled} frames", valid="a seed or more, frames from 0")
    result: dict[str, Any] = {"evaluations_per_second": round(evaluation_rate())}
    missed, tables = [], []
    if result["evaluations_per_second"] < LEAST_RATE:
        missed.append(f"{result['evaluations_per_second']} evaluations/s, not {LEAST_RATE:.0f}")
    for folder in sequences:
        sequence = open_sequence(folder)
        found = over_bound(sequence, f"simulated:{sigma:g}", seeds)
        found["sampling"] = sampling_speed(sequence, sigma, sampled)
        result[sequence.manifest.name] = found
        for row in found["sampling"]:
            if (
                not row["converged"]
                or row["effective"] < LEAST_EFFECTIVE
                or (row["seconds"] > MOST_SECONDS)
            ):
                missed.append(f"{sequence.manifest.name}, frame {row['frame']}: {row['outcome']} "
                              f"in {row['seconds']} s")  # fmt: skip
        tables.append(_table(sequence, found))
        if learned:
            found["learned"] = by_detector = over_bound(sequence, "learned", 1)
            tables.append(_table(sequence, by_detector))
            if by_detector["ratio"] > MOST_OVER_BOUND:
                missed.append(
                    f"{sequence.manifest.name}, the detector's noise: "
                    f"{by_detector['ratio']} times the bound, not {MOST_OVER_BOUND}"
                )
    content = content_hashes(open_sequence(folder) for folder in sequences)
    return Outcome(result, tables, missed, content)


def _table(sequence: Sequence, result: dict[str, Any]) -> Table:
    rows = tuple(
        (name, number(v["bound_mm"]), number(v["tracked_mm"]), number(v["ratio"], 2),
         number(v["skeleton_mm"]))
        for name, v in result["joints"].items()
    )  # fmt: skip
    title = f"{sequence.manifest.name}, {result['detections']}: root mean square"
    return Table(title, ("joint", "bound mm", "tracker mm", "ratio", "skeleton mm"), rows)


def evaluation_rate(walkers: int = 96, rounds: int = 200) -> float:
    """Log posteriors of 37 angles a second, two views of 18 detections, in batches of walkers."""
    from egocap.body.proportions import Proportions
    from egocap.cameras.rig_files import load_rig
    from egocap.posterior.log_prob import make_log_posterior
    from egocap.posterior.synthetic_pose import draw_detections, draw_poses
    from egocap_sim.core.resources import rig_file

    rng = np.random.default_rng(0)
    config = PosteriorConfig(model_error_m=0.0)
    rig, person = load_rig(rig_file("egorig1")).resized(640, 512), Proportions.from_lengths(1.75)
    poses = draw_poses(walkers, config, rng)
    seen = np.ones((1, 2, len(LABELS)), bool)
    found = draw_detections(poses[:1], seen, rig, person, 2.0, config, rng)
    density = make_log_posterior(found, 0, rig, person, config)
    density(poses)  # compiles
    started = time.perf_counter()
    for _ in range(rounds):
        density(poses)
    return rounds * walkers / (time.perf_counter() - started)


def over_bound(sequence: Sequence, source: str, seeds: int) -> dict[str, Any]:
    """Root mean square of bound and of tracker errors per joint, mm.

    The noise of simulated detections is known. For a detector, the bound uses its stated standard
    deviations, of occluded joints too, and temporally correlated noise. `claimed`: root mean square
    of error over stated standard deviation at visible joints; 1 if calibrated.
    """
    from egocap.pose.config import TrackerConfig
    from egocap.posterior.information import (
        Noise,
        fisher_information,
        lasting_information,
        smoothed_bound,
    )
    from egocap.track.noise_estimation import autocorrelation
    from egocap_eval.priors.takes import fit_angles

    truth, rig, person = sequence.truth, sequence.rig, sequence.body
    angles, config = fit_angles(truth.joints_head, person), TrackerConfig()
    nearest = 1e3 * np.linalg.norm(forward(person, angles) - truth.joints_head, axis=-1)
    seen = (truth.visibility == VISIBLE) & truth.in_view
    draws = [detections_from(sequence, source, seed) for seed in range(seeds)]
    result: dict[str, Any] = {"frames": len(sequence), "detections": source, "seeds": seeds}
    if source.startswith("simulated"):
        noise = Noise(parse_source(source).sigma)
        information, between = fisher_information(angles, person, rig, seen, noise), None
    else:
        found, made = draws[0], draws[0].valid & truth.in_view
        off = (found.points - truth.joints_2d) / np.where(made, found.sigma, 1.0)[..., None]
        result["claimed"] = round(_rms(off[seen & made]), 3)
        result["correlation"] = round(autocorrelation(off, seen & made), 3)
        noise = Noise(correlation=result["correlation"])
        information, between = lasting_information(angles, person, rig, made, noise, found.sigma)
    bound = smoothed_bound(angles, person, sequence.times, information, config, between)
    tracks = [egocap.Tracker(rig, person, config).track(found, sequence.images) for found in draws]
    errors = np.array([1e3 * np.linalg.norm(t.joints_head - truth.joints_head, axis=-1)
                       for t in tracks])  # fmt: skip
    joints = {}
    shown = seen.any(1)
    for j in EVALUATED:
        if not shown[:, j].any():
            continue
        low, got = _rms(bound[shown[:, j], j]), _rms(errors[:, shown[:, j], j])
        joints[LABELS[j]] = {"bound_mm": round(low, 2), "tracked_mm": round(got, 2),
                             "ratio": round(got / low, 3),
                             "seen": round(float(shown[:, j].mean()), 3),
                             "skeleton_mm": round(_rms(nearest[shown[:, j], j]), 2)}  # fmt: skip
    shown[:, [j for j in range(len(LABELS)) if j not in EVALUATED]] = False
    low, got = _rms(bound[shown]), _rms(errors[:, shown])
    return result | {
        "bound_mm": round(low, 2), "tracked_mm": round(got, 2), "ratio": round(got / low, 3),
        "joints": joints,
    }  # fmt: skip


def sampling_speed(sequence: Sequence, sigma: float, count: int) -> list[dict[str, Any]]:
    """Sample some frames; time and effective sample size of each."""
    from egocap.posterior.log_prob import make_log_posterior
    from egocap.posterior.sampler import sample

    found = detections_from(sequence, f"simulated:{sigma:g}", 0)
    config = PosteriorConfig(degrees=np.inf)
    rows = []
    with progress("sampling", count) as advance:
        for frame in np.linspace(0, len(sequence) - 1, count).astype(int):
            cpu = time.process_time()
            density = make_log_posterior(found, int(frame), sequence.rig, sequence.body, config)
            result = sample(density, SamplerConfig(effective=LEAST_EFFECTIVE), frame=int(frame))
            rows.append({
                "frame": int(frame), "converged": result.converged, "outcome": result.outcome,
                "steps": result.steps, "seconds": round(result.seconds, 1),
                "cpu_seconds": round(time.process_time() - cpu, 1),
                "effective": round(float(result.effective.min())),
                "of_angle": result.names[int(result.effective.argmin())],
                "largest_rhat": round(float(result.rhat.max()), 4),
                "tail_effective": round(float(result.tail_effective.min())),
                "modes": len(result.modes),
            })  # fmt: skip
            advance()
    return rows


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
