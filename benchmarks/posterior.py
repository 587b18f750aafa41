"""Measure evaluations of the log posterior per second, and the sampling time of a frame.

    python benchmarks/posterior.py
    python benchmarks/posterior.py --json --frames 5 --arviz

Synthetic poses of an average person are projected into EgoRig1 at 640 x 512 with 2 px noise; each
view misses 30 % of the joints. Rates are given by wall time and by processor time, which depends
less on other load. All cores are used; NUMBA_NUM_THREADS sets the number. With --arviz, ArviZ also
computes the least effective sample size and the largest R-hat, with every walker as a chain.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.information import (
    Noise,
    fisher_information,
    joint_bound,
    prior_information,
)
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.result import Posterior, to_arviz
from egocap.posterior.sampler import sample
from egocap.posterior.synthetic_pose import draw_detections, draw_poses

ROOT = Path(__file__).resolve().parents[1]
WALKERS, ROUNDS, MISSING = 96, 300, 0.3


def measure(frames: int, arviz: bool = False) -> dict[str, Any]:
    """Rates of evaluation, time of a bound, and the sampling of some frames."""
    rng, config = np.random.default_rng(0), PosteriorConfig(model_error_m=0.0)
    rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(640, 512)
    person = Proportions.from_lengths(1.75)
    poses = draw_poses(WALKERS, config, rng)
    seen = rng.random((WALKERS, 2, 18)) >= MISSING
    found = draw_detections(poses, seen, rig, person, 2.0, config, rng)
    density = make_log_posterior(found, 0, rig, person, config)
    wall, cpu = _timed(lambda: density(poses), ROUNDS)
    bound = _timed(
        lambda: joint_bound(
            poses,
            person,
            fisher_information(poses, person, rig, seen, Noise()) + prior_information(poses),
        ),
        3,
    )
    rows = []
    for frame in range(frames):
        cpu_before = time.process_time()
        result = sample(make_log_posterior(found, frame, rig, person, config), SamplerConfig())
        worst = int(result.effective.argmin())
        row = {
            "converged": result.converged, "outcome": result.outcome, "modes": len(result.modes),
            "steps": result.steps, "acceptance": round(result.acceptance, 3),
            "seconds": round(result.seconds, 1),
            "cpu_seconds": round(time.process_time() - cpu_before, 1),
            "least_effective": round(float(result.effective[worst])),
            "of_angle": result.names[worst],
            "largest_rhat": round(float(result.rhat.max()), 4),
            "least_tail_effective": round(float(result.tail_effective.min())),
        }  # fmt: skip
        rows.append(row | (_by_arviz(result) if arviz else {}))
    return {
        "evaluations_per_second": round(WALKERS / wall),
        "evaluations_per_cpu_second": round(WALKERS / cpu),
        "bound_ms_a_frame": round(1e3 * bound[1] / WALKERS, 2),
        "sampled": rows,
    }


def _by_arviz(result: Posterior) -> dict[str, Any]:
    """Effective sample sizes and R-hat by ArviZ. Raises MachineError where it is missing."""
    data = to_arviz(result)
    from arviz import ess, rhat

    names = list(result.names)
    bulk, tail = (ess(data, var_names=names, method=m).to_array() for m in ("bulk", "tail"))
    return {
        "arviz_draws": int(np.prod(result.draws.shape[:2])),
        "arviz_bulk_effective": round(float(bulk.min())),
        "arviz_tail_effective": round(float(tail.min())),
        "arviz_largest_rhat": round(float(rhat(data, var_names=names).to_array().max()), 4),
    }


def _timed(work: Any, rounds: int) -> tuple[float, float]:
    """Wall and processor seconds of one call, after compilation."""
    work()
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(rounds):
        work()
    return (time.perf_counter() - wall) / rounds, (time.process_time() - cpu) / rounds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--arviz", action="store_true", help="needs egocap[posterior]")
    options = parser.parse_args()
    report = measure(options.frames, options.arviz)
    if options.json:
        print(json.dumps(report, indent=1))
        return
    print(f"{report['evaluations_per_second']} evaluations/s, "
          f"{report['evaluations_per_cpu_second']} a processor second; "
          f"bound {report['bound_ms_a_frame']} ms a frame")  # fmt: skip
    for row in report["sampled"]:
        print(row)


if __name__ == "__main__":
    main()
