"""The tables of speed, simulated detections, rigs, uncertainty, simulation and image model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from egocap_eval.evidence.page_table import Results, Row, markdown, number
from egocap_eval.studies import doubt as doubt_study

ABLATIONS = {
    "ablation-test.json": "test set, images",
    "ablation-validation.json": "validation set, images",
    "ablation.json": "procedural, simulated detections",
}

_TRACKED, _REFINED = "contacts, noisy head", "noisy head, refined"


def speed(results: Results) -> str:
    """Frames a second of the detector, the tracker and the whole."""
    return markdown(
        ("speed, two threads", "frames/s"),
        [
            *results.rows("runtime.json", "whole", _speeds),
            *results.rows(
                "detector_speed.json",
                "detector",
                lambda r: [
                    (f"detector alone, {name}", number(e["pairs_per_second"]))
                    for name, e in r["engines"].items()
                    if "missing" not in e
                ],
            ),
        ],
        results,
    )


def simulated(results: Results) -> str:
    """Tracking from simulated detections."""
    header = (
        "sequence and detections",
        "frames",
        "all, mm",
        "worst seed",
        "visible",
        "hidden",
        "visible joints, %",
        "frames/s",
    )
    rows = results.rows(
        "accuracy.json",
        "sequences",
        lambda r: [
            (
                f"{row['sequence']}, {_source(row['detections'])}",
                str(row["frames"]),
                number(row["mpjpe_mm"]),
                number(row["worst_seed_mm"]),
                number(row["seen_mm"]),
                number(row["hidden_mm"]),
                number(100 * row["seen_share"], 0),
                number(row["frames_per_second"], 0),
            )
            for row in r["rows"]
        ],
    )
    return markdown(header, rows, results)


def baseline(results: Results) -> str:
    """Tracked error and bound by the distance between the cameras, and the verdicts."""
    header = ("distance between the cameras", "tracked error, mm", "bound, mm")
    rows = results.rows(
        "rig.json",
        "sweep",
        lambda r: [
            (
                f"{c['measures']['baseline']:.2f} m",
                number(c["tracked"]["tracked_mm"]),
                number(c["bound_mm"]),
            )
            for c in r["candidates"]
            if c["tracked"]
        ],
    )
    rows += results.rows(
        "stress.json",
        "stress",
        lambda r: [(f"over six motions: {r['best_baseline']['words']}", "", "")],
    )
    return markdown(header, rows, results)


def coverage(results: Results) -> str:
    """Coverage of the posterior's regions, on its own model's data and on detections."""
    header = ("data", "frames", "50 %", "80 %", "95 %", "chains not converged")
    rows = results.rows("calibration.json", "the posterior's own model", _covered)
    return markdown(header, rows, results)


def _covered(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    yield "the posterior's own model", *_coverage(result["well_specified"])
    if "error_model" not in result:
        yield "the detector, not measured with its error model yet", *5 * ("-",)
        return
    yield "the detector, errors as stated", *_coverage(result["before"])
    temperature = result["error_model"]["temperature"]
    yield (
        f"the detector by its error model, temperature {temperature:.2f} from error correlations",
        *_coverage(result["after"]),
    )


def ablation(results: Results) -> str:
    """The effect of each part of our tracker and of the paper's."""
    header = ("variant", "error, mm", "change, mm", "arms", "legs", "visible", "hidden")
    rows: list[Row] = []
    for file, name in ABLATIONS.items():
        rows += results.rows(
            file,
            name,
            lambda r, name=name: [
                (
                    f"{name}: {row['variant']}",
                    number(row["mpjpe_mm"]["mean"]),
                    _plus_minus(row["change_mm"]),
                    *(number(row[m]) for m in ("upper_mm", "lower_mm", "seen_mm", "hidden_mm")),
                )
                for row in r["rows"]
            ],
        )
    return markdown(header, rows, results)


def simulation(results: Results) -> str:
    """Speed of generation and rendering."""
    rows = results.rows("generation-long.json", "generation", _generated)
    rows += results.rows("generation.json", "generation", _generated)
    rows += results.rows(
        "episodes.json",
        "episodes",
        lambda r: [
            (
                f"{row['scene']}, episodes, workers: {row['workers']}",
                number(row["fps"]),
                f"{100 * row['preparation']:.1f} % of it preparing episodes",
            )
            for row in r["rows"]
        ],
    )
    rows += results.rows(
        "rendering.json",
        "rendering",
        lambda r: [
            (
                f"rendering alone, {row['size']}",
                number(row["fps"]),
                f"{row['ratio']:.1f} times stock pyrender",
            )
            for row in r["rows"]
        ],
    )
    return markdown(("stereo frames a second", "frames/s", ""), rows, results)


def cost(results: Results) -> str:
    """Core hours and storage of a million and a hundred million frames, from the measured rates."""

    def rows_of(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
        found = []
        for row in result["rows"]:
            rate, size = row["steady_fps"] / row["workers"], row["mb_per_frame"]
            hours = 1e6 / rate / 3600.0  # of one worker, which takes one core
            found.append((
                row["scene"], str(row["workers"]), number(rate), number(rate * size),
                f"{hours:.0f} core hours, {size:.2f} TB",
                f"{100.0 * hours:,.0f} core hours, {100.0 * size:.0f} TB",
            ))  # fmt: skip
        return found

    header = ("scene", "workers", "frames/s a worker", "MB/s a worker", "10^6 frames",
              "10^8 frames")  # fmt: skip
    return markdown(header, results.rows("episodes.json", "cost", rows_of), results)


def start_up(results: Results) -> str:
    """Seconds of whole commands."""
    rows = results.rows(
        "start_up.json",
        "start up",
        lambda r: [
            (f"`{row['command']}`", number(row["warm_s"][len(row["warm_s"]) // 2]),
             number(row["cold_s"]))
            for row in r["rows"]
        ],
    )  # fmt: skip
    header = ("command, start to exit", "seconds", "the first time on a machine")
    return markdown(header, rows, results)


def refined(results: Results) -> str:
    """What following a track with a simulated body changes."""
    measures = {"mpjpe_mm": 1, "world_accel_error": 1, "foot_skate": 3, "penetration_mm": 1}

    def cells(entry: Mapping[str, Any]) -> tuple[str, ...]:
        before, after = entry[_TRACKED], entry[_REFINED]
        pairs = [(before[m], after[m], digits) for m, digits in measures.items()]
        pairs.append((after["residual_before"], after["residual"], 3))
        shown = (f"{number(a, digits)}, {number(b, digits)}" for a, b, digits in pairs)
        return (entry["recording"], f"{after['refined']:.0f} of {entry['frames']}", *shown,
                number(after["force_error"], 2))  # fmt: skip

    rows = results.rows("world.json", "rows", lambda r: map(cells, r["rows"]))
    header = ("each: tracked, refined", "frames refined", "mean error, mm",
              "acceleration error, m/s²", "foot skate, m/s", "penetration, mm",
              "residual force, body weights", "error of a foot's force, body weights")  # fmt: skip
    return markdown(header, rows, results)


def doubt(results: Results) -> str:
    """Stated and true shares of joints within 5 cm, of tracks from wrong inputs."""
    rows = results.rows("doubt.json", "faults", lambda r: doubt_study.table(r["faults"]).rows)
    return markdown(doubt_study.table({}).header, rows, results)


def physics(results: Results) -> str:
    """How closely simulated people follow recorded clips."""
    measures = {
        "joint_error_cm": "joint error, cm",
        "joint_error_max_cm": "largest, cm",
        "planted_foot_speed_cm_s": "slide of planted feet, cm/s",
        "penetration_cm": "depth in the floor, cm",
        "residual_wrench_bw": "residual wrench, body weights",
        "ms_per_second": "ms of one core a second",
    }
    rows = results.rows(
        "physics.json",
        "clips",
        lambda r: [
            (f"{name} of {r['clips']} clips", *(number(r[name][m], 2) for m in measures))
            for name in ("median", "worst")
        ],
    )
    return markdown(("clip", *measures.values()), rows, results)


def image_model(results: Results) -> str:
    """Speed of the image model, and tracking without a detector."""
    rows = results.rows("image_model_times.json", "times", _image_model_times)
    rows += results.rows(
        "image_model.json",
        "tracking",
        lambda r: [
            (
                f"upper body without a detector, clip {i + 1}: mean error",
                f"{e['mean_mm']:.0f} mm",
                f"legs {e['legs_mm']:.0f} mm; lost of {e['frames']} frames: left arm "
                "{left}, right arm {right}".format(**e["lost_frames"]),
            )
            for i, e in enumerate(r["live"].values())
        ],
    )
    return markdown(("image model, both views at 128 x 128", "", ""), rows, results)


def _speeds(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    pipeline = result["pipeline"]
    latency = pipeline["live"]["latency_ms"]
    yield "images to poses, all frames", number(pipeline["batch"]["frames_per_second"])
    yield (
        f"images to poses, live (latency {latency['median']:.0f} ms, 95 % below "
        f"{latency['p95']:.0f} ms)",
        number(pipeline["live"]["frames_per_second"]),
    )
    for name, solver in result["solvers"].items():
        yield (
            f"tracker alone, {name}, {solver['mpjpe_mm']:.0f} mm over {solver['frames']} frames",
            number(solver["frames_per_second"]),
        )


def _source(words: str) -> str:
    names = {
        "simulated:0,occluded=keep": "exact, all joints",
        "simulated:2.0": "2 px noise, hidden joints missing",
    }
    return names.get(words, "errors of a weaker detector")


def _coverage(measured: Mapping[str, Any]) -> list[str]:
    levels = measured["levels"]
    return [
        str(measured["frames"]),
        *(f"{100 * levels[level]['coverage']:.1f} %" for level in ("0.5", "0.8", "0.95")),
        f"{measured['not_converged']} of {measured['frames']}",
    ]


def _plus_minus(entry: Mapping[str, float] | None) -> str:
    return "-" if entry is None else f"{entry['mean']:+.1f} +- {entry['half_interval']:.1f}"


def _image_model_times(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    kernel, reference = result["kernel"]["ratio"], result["reference"]["ratio"]
    yield (
        "energy and gradient",
        f"{kernel['energy_and_gradient']['ms']:.1f} ms",
        f"{reference['times_slower']:.0f} times faster than torch with autograd",
    )
    yield "a stochastic step of 600 rays", f"{result['stochastic']['step']['ms']:.2f} ms", ""
    live = result["live"]
    yield "upper body without a detector", f"{live['frames_per_second']:.0f} frames/s", ""


def _generated(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    for row in result["rows"]:
        yield (
            f"{row['size']}, {row['frames']} frames, workers: {row['workers']}",
            number(row["fps"]),
            f"{row['steady_fps']:.1f} after start-up",
        )
