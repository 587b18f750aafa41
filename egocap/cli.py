"""The command `egocap`: motion out of footage."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional
from tyro.extras import SubcommandApp

from egocap.commandline import DONE, INTERRUPTED, run
from egocap.detect.training_config import TrainingConfig
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.track.config import TrackerConfig
from egocap.track.fit_config import FitConfig

if TYPE_CHECKING:
    from egocap.results import Detections, Track
    from egocap.sequence import Sequence
    from egocap.track.fit_body import BodyFit

app = SubcommandApp()


@app.command
def track(
    sequence: Positional[Path],
    out: Path,
    detections: str = "learned",
    config: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = TrackerConfig(),  # noqa: B008
    seed: int = 0,
    body: Path | None = None,
    save_detections: Path | None = None,
    head_pose: Path | None = None,
    json: bool = False,
) -> int:
    """Recover 37 joint angles in every frame of a sequence from detections in both views.

    The tracker is given detections, the rig and the person's proportions; never the truth.

    Args:
        sequence: folder of a sequence.
        out: track to write, npz.
        detections: where detections come from: the learned detector (learned:FILE for other weights
            than the shipped); simulated:SIGMA[,outliers=P][,occluded=keep|drop] draws them from the
            truth, SIGMA in pixels at 640 x 512; or a file of detections.
        config: the tracker's settings.
        seed: seed of simulated detections.
        body: the person's proportions, as fit-body writes them; by default the sequence's own.
        save_detections: also write the detections used, npz.
        head_pose: where the head was, as you know it from elsewhere: npz with `time` (s) and
            `T_world_head` (4 x 4); the track then has its joints in that world, too.
        json: print the summary as JSON.
    """
    from egocap import results
    from egocap.body import Proportions
    from egocap.io.head_pose import in_world
    from egocap.sequence import Sequence
    from egocap.sequence_writer import disk_errors
    from egocap.track.tracker import track as run_tracker

    opened = Sequence(sequence)
    proportions = opened.proportions if body is None else Proportions.load(body)
    found = detections_from(opened, detections, seed)
    result = run_tracker(found, opened.rig, proportions, config, lambda i: opened.frame(i).images)
    of_sequence = {"sequence": opened.manifest.config_sha256}  # so that no other is scored with it
    result = replace(result, config=result.config | of_sequence)
    if head_pose is not None:
        result = in_world(result, head_pose)
    for path in (out, save_detections):
        if path is not None:
            with disk_errors(path.parent):
                path.parent.mkdir(parents=True, exist_ok=True)
    if save_detections is not None:
        results.save_detections(save_detections, found)
    results.save_track(out, result)
    _print_summary(out, result, json)
    return DONE


@app.command
def detect(
    sequence: Positional[Path],
    out: Path,
    weights: Path | None = None,
    engine: str = "auto",
    threads: int | None = None,
    frames: int | None = None,
    json: bool = False,
) -> int:
    """Find the body's 18 parts in every view of a sequence.

    Args:
        sequence: folder of a sequence.
        out: detections to write, npz.
        weights: detector weights, safetensors; those shipped by default.
        engine: auto (the fastest here), onnxruntime, openvino (an extra), torch, or cuda.
        threads: threads of the network; all cores by default.
        frames: only so many frames, from the first.
        json: print the summary as JSON.
    """
    import time

    from egocap.commandline import progress
    from egocap.detect import detector as learned
    from egocap.detect.weights import open_weights
    from egocap.results import save_detections
    from egocap.sequence import Sequence
    from egocap.sequence_writer import disk_errors

    opened = Sequence(sequence)
    made = learned.Detector(opened.rig, open_weights(weights), engine, threads)  # type: ignore[arg-type]
    started = time.perf_counter()
    with progress("detect", frames or len(opened)) as advance:
        found = learned.detect(opened, made, frames=frames, on_frames=advance)
    seconds = time.perf_counter() - started
    with disk_errors(out.parent):
        out.parent.mkdir(parents=True, exist_ok=True)
    save_detections(out, found)
    _print_detections(out, found, opened.rig.views, seconds, json)
    return DONE


@app.command
def calibrate_detector(
    data: Positional[tuple[Path, ...]],
    /,
    weights: Path,
    out: Path,
    store: Path | None = None,
    json: bool = False,
) -> int:
    """Fit a detector's confidence and spread to footage that it was not trained on.

    Writes the same weights with the calibration that was found.

    Args:
        data: sequences, or folders of sequences.
        weights: detector weights to calibrate, safetensors.
        out: weights to write, safetensors; may be the same file.
        store: folder to keep the canonical views made from the data; a temporary one by default.
        json: print the calibration as JSON.
    """
    import tempfile

    from egocap.detect.calibrating import calibrate
    from egocap.detect.weights import open_weights

    with tempfile.TemporaryDirectory() as temporary:
        found = calibrate(open_weights(weights), data, store or Path(temporary), out)
    _print_calibration(out, found.to_dict(), json)
    return DONE


@app.command
def train(
    data: Positional[tuple[Path, ...]],
    /,
    out: Path,
    config: str = "default",
    training: Annotated[TrainingConfig, tyro.conf.OmitArgPrefixes] = TrainingConfig(),  # noqa: B008
    rig: Path | None = None,
    resume: bool = False,
    start: Path | None = None,
    scratch: bool = False,
    held_out: float = 0.08,
    store: Path | None = None,
    backgrounds: tuple[Path, ...] = (),
    shares: tuple[float, ...] = (),
    json: bool = False,
) -> int:
    """Train a detector, from footage with annotations or from nothing but a rig.

    Writes detector.safetensors, curves.png, log.csv and validation.csv into the folder of the run.
    SIGTERM and Ctrl-C stop it at the next step, to go on with --resume.

    Args:
        data: sequences, or folders of sequences.
        out: folder of the run.
        config: network to train: default, small, paper (ResNet-101) or tiny.
        training: how to train.
        rig: simulate footage for this rig for a third of the minutes, and train on it too.
        resume: go on with the run in --out, if there is one.
        start: weights to begin from: detector weights, or the folder of a run. With a rig and the
            default network, those that are shipped.
        scratch: begin from random weights, also with a rig.
        held_out: share of the sequences to validate on and never train on.
        store: folder of the canonical views made from the data; by default in --out.
        backgrounds: sequences whose images replace backgrounds; by default those of the data.
        shares: how much of the training is on each DATA; by default as many views as it has.
        json: print the summary as JSON.
    """
    import subprocess
    import sys

    from egocap.detect.training_run import (
        Request,
        command_for_devices,
        join_processes,
        train_detector,
        weights_path,
    )
    from egocap.detect.weights import SHIPPED, shipped_file

    if scratch and start is not None:
        raise InputError("--scratch and --start exclude each other", valid="one of them")
    if start is None and rig is not None and config == SHIPPED and not scratch:
        start = shipped_file()
    request = Request(out, tuple(data), rig, config, held_out, start, resume, store, backgrounds,
                      shares)  # fmt: skip
    command = command_for_devices(sys.argv[1:])
    if command is not None:
        return subprocess.call(command)
    join_processes()
    outcome = train_detector(request, training)
    summary = {
        "finished": outcome.finished, "steps": outcome.state.step, "views": outcome.state.views,
        "seconds": round(outcome.state.seconds, 1),
        "weights": str(weights_path(out)) if outcome.weights else None,
        "scores": None if outcome.scores is None else outcome.scores.to_dict(),
    }  # fmt: skip
    _print_training(out, summary, json)
    return DONE if outcome.finished else INTERRUPTED


@app.command
def fit_body(
    sequence: Positional[Path],
    out: Path,
    detections: str = "learned",
    height: float | None = None,
    seconds: float = 20.0,
    config: Annotated[FitConfig, tyro.conf.OmitArgPrefixes] = FitConfig(),  # noqa: B008
    seed: int = 0,
    shape: Path | None = None,
    json: bool = False,
) -> int:
    """Find a person's bone lengths from a few poses or the first seconds of any motion.

    Bones that the motion does not show stay at what is usual, and the report says so.

    Args:
        sequence: folder of a sequence.
        out: body to write, json.
        detections: where they come from, as for track.
        height: of the person in metres, where it is known.
        seconds: how much of the sequence to look at, from its beginning.
        config: the fit's settings.
        seed: seed of simulated detections.
        shape: also find sizes and colours of the Gaussians from the images; json to write.
        json: print the report as JSON.
    """
    from egocap.sequence import Sequence
    from egocap.sequence_writer import disk_errors
    from egocap.track.fit_body import first_seconds
    from egocap.track.fit_body import fit_body as fit

    opened = Sequence(sequence)
    found = first_seconds(detections_from(opened, detections, seed), seconds)
    result = fit(found, opened.rig, height, config)
    for path in (out, shape):
        if path is not None:
            with disk_errors(path.parent):
                path.parent.mkdir(parents=True, exist_ok=True)
    sizes = None
    if shape is not None:
        from egocap.track.body_shape import fit_shape

        frames = [(opened.frame(int(t)).images, result.angles[i]) for i, t in result.spread(6)]
        fitted = fit_shape(result.proportions, opened.rig, frames)
        sizes = fitted.scales
        with disk_errors(shape.parent):
            fitted.body.save(shape)
    with disk_errors(out.parent):
        result.proportions.save(out)
    _print_body(out, result, sizes, json)
    return DONE


@app.command
def export(
    track: Positional[Path],
    out: Path,
    format: Literal["bvh", "npz"] = "bvh",
) -> int:
    """Write a track for other programs.

    bvh opens in Blender and other animation tools: metres, y up, the skeleton from the hips. npz
    holds plain arrays with the joints' names. Both are in the world where the track was made with
    --head-pose, else about a head that stays where it is.

    Args:
        track: track to read, npz.
        out: file to write.
        format: what to write.
    """
    from egocap.io.arrays import write_arrays
    from egocap.io.bvh import write_bvh
    from egocap.results import load_track

    found = load_track(track)
    {"bvh": write_bvh, "npz": write_arrays}[format](out, found)
    print(f"{out}: {len(found.times)} frames")
    return DONE


@app.command
def posterior(
    sequence: Positional[Path],
    out: Path,
    frame: int,
    detections: str = "learned",
    config: Annotated[PosteriorConfig, tyro.conf.OmitArgPrefixes] = PosteriorConfig(),  # noqa: B008
    sampling: Annotated[SamplerConfig, tyro.conf.OmitArgPrefixes] = SamplerConfig(),  # noqa: B008
    page: Path | None = None,
    checkpoint: Path | None = None,
    json: bool = False,
) -> int:
    """Sample what one frame's detections say about the pose: how sure it is, joint by joint.

    A chain that has not mixed is written all the same, and said to be so.

    Args:
        sequence: folder of a sequence.
        out: posterior to write, npz.
        frame: frame of the sequence, from 0.
        detections: where detections come from, as for `egocap track`; their noise has seed 0.
        config: what is believed before the detections, and how they scatter.
        sampling: how long to sample.
        page: page of pictures to write, html.
        checkpoint: chain to keep, npz; the same command takes up a killed run from it.
        json: print the summary as JSON.
    """
    import json as jsons

    from egocap.posterior.command import write_posterior
    from egocap.sequence import Sequence

    opened = Sequence(sequence)
    found = detections_from(opened, detections, 0)
    told = write_posterior(
        opened, found, frame, out, config, sampling, page=page, checkpoint=checkpoint
    )
    if json:
        print(jsons.dumps(told, indent=1))
        return DONE
    ends = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
    hands = ", ".join(f"{j.replace('_', ' ')} {told['spread_mm'][j]} mm" for j in ends)
    print(f"{out}: {told['outcome']}; {told['steps']} steps in {told['seconds']} s; spread {hands}")
    for note in told["notes"]:
        print(note)
    return DONE


@app.command
def live(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    body: Path,
    out: Path | None = None,
    weights: Path | None = None,
    seconds: float = float("inf"),
    config: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = TrackerConfig(smoothing="none"),  # noqa: B008
    json: bool = False,
) -> int:
    """Track from cameras or video files as they run, one a view, in the rig's order.

    The newest pictures are taken and older ones skipped, so that the tracker never falls behind. A
    video file runs at its own rate.

    Args:
        sources: cameras' numbers or video files, one a view.
        rig: rig file of the cameras.
        body: body file of the wearer.
        out: track to write when all is over, npz.
        weights: weights of the learned detector; the shipped ones by default.
        seconds: stop after so long.
        config: the tracker's settings; past frames alone count.
        json: print the summary as JSON.
    """
    import json as jsons

    from egocap.body import Proportions
    from egocap.detect.detector import Detector
    from egocap.detect.weights import open_weights
    from egocap.live import Source, follow_live
    from egocap.results import save_track
    from egocap.rig import load_rig
    from egocap.track.live import LiveTracker

    loaded = load_rig(rig)
    if len(sources) != len(loaded.mounts):
        raise InputError(f"{len(sources)} sources", valid=f"{len(loaded.mounts)}, one a view")
    detector = Detector(loaded, open_weights(weights) if weights else None)
    tracker = LiveTracker(loaded, Proportions.load(body), config)
    opened = [Source(name) for name in sources]
    try:
        report = follow_live(opened, detector, tracker, seconds)
    finally:
        for source in opened:
            source.close()
    if out is not None:
        save_track(out, report.track(tracker, detector.source))
    middle, late = report.latency_ms
    summary = {"poses": len(report.poses), "skipped_pictures": report.skipped,
               "latency_ms": middle, "latency_95_ms": late}  # fmt: skip
    if json:
        print(jsons.dumps(summary, indent=1))
    else:
        print(f"{len(report.poses)} poses, latency {middle:.0f} ms (95 %: {late:.0f}), "
              f"{report.skipped} pictures skipped")  # fmt: skip
    return DONE


@app.command
def view(
    what: Positional[Literal["model"]],
    sequence: Positional[Path],
    out: Path,
    frame: int = 0,
    track: Path | None = None,
    gaussians: Path | None = None,
    size: tuple[int, int] = (256, 256),
) -> int:
    """Draw what the method makes of one frame.

    model: image, rendered density, visibility of the Gaussians, colour dissimilarity and energy of
    every pixel. Without a track, the pose is the one nearest to a simulated sequence's truth.

    Args:
        what: what to draw.
        sequence: folder of a sequence.
        out: picture to write, png.
        frame: frame of the sequence, from 0.
        track: track whose pose to draw, npz.
        gaussians: volumetric body to draw, json; by default one coloured by the frame itself.
        size: width and height at which a view is evaluated, pixels.
    """
    from egocap.view.command import view_model

    summary = view_model(sequence, frame, out, track, gaussians, size)
    print(f"{out}: energy {summary['energy']:.1f}, {summary['covered_pixels']:.0f} pixels covered")
    return DONE


def main() -> int:
    """Run `egocap` and return its exit code."""
    return run(app, prog="egocap", description="Full-body motion from head-worn fisheye cameras.")


def detections_from(sequence: Sequence, source: str, seed: int) -> Detections:
    """Detections of a sequence by the name of their source, or from a file; `seed` is of noise.

    Raises InputError or FileError, also for a file made from other frames than the sequence's.
    """
    import numpy as np

    from egocap.detect.simulated import FORM, parse_source, simulate_detections
    from egocap.evaluate.checks import require_same_times
    from egocap.results import load_detections
    from egocap.sequence import VISIBLE

    if source.endswith(".npz"):
        found = load_detections(source)
        require_same_times(found.times, sequence.times, source)
        return found
    if source.partition(":")[0] == "learned":
        return _learned(sequence, source.partition(":")[2])
    if source.partition(":")[0] != "simulated":
        valid = f"{FORM}; learned[:FILE]; a file of detections, .npz"
        raise InputError(f"unknown source of detections '{source}'", valid=valid)
    if seed < 0:
        raise InputError(f"seed {seed}", valid="0 or more")
    camera = sequence.rig.mounts[0].camera
    truth = sequence.truth  # handed to the simulated detector alone
    return simulate_detections(
        truth.joints_2d, truth.visibility == VISIBLE, truth.in_view, truth.time,
        (camera.width, camera.height), parse_source(source), np.random.default_rng(seed),
    )  # fmt: skip


def _print_summary(path: Path, result: Track, as_json: bool) -> None:
    rate = 1.0 / result.seconds_per_frame
    summary = {
        "track": str(path), "frames": len(result.times), "frames_per_second": rate,
        "converged": int(result.converged.sum()),
        "detections_per_frame": float(result.detections_used.mean()),
    }  # fmt: skip
    if as_json:
        print(json.dumps(summary, indent=1))
        return
    print(f"{path}: {summary['frames']} frames tracked, {rate:.0f} frames/s on one core, "
          f"{summary['converged']} converged, {summary['detections_per_frame']:.1f} detections a "
          "frame of 2 x 18")  # fmt: skip


def _print_body(path: Path, fit: BodyFit, sizes: dict[str, float] | None, as_json: bool) -> None:
    report = fit.report()
    if as_json:
        summary: dict[str, Any] = {
            "body": str(path), "frames": len(fit.frames), "detections": fit.detections,
            "converged": fit.converged, "residual": round(fit.residual, 3), "bones": report,
        }  # fmt: skip
        print(json.dumps(summary if sizes is None else summary | {"sizes": sizes}, indent=1))
        return
    unfinished = "" if fit.converged else "; not converged"
    print(f"{path}: from {fit.detections} detections in {len(fit.frames)} frames, which miss by "
          f"{fit.residual:.2f} standard deviations{unfinished}")  # fmt: skip
    verdicts = {"well": "well determined", "badly": "badly determined",
                "prior": "not seen: what is usual"}  # fmt: skip
    print(f"{'bone to':16s} {'length':>9s} {'std':>7s}")
    for name, line in report.items():
        if not name.startswith("right_"):
            bone = name.replace("left_", "")
            print(f"{bone:16s} {1e3 * float(line['length_m']):6.0f} mm {line['std_percent']:5.1f} %"
                  f"  {verdicts[str(line['determined'])]}")  # fmt: skip
    if sizes is not None:
        print("sizes: " + ", ".join(f"{part} {100 * size:.0f} %" for part, size in sizes.items()))


def _print_training(out: Path, summary: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(summary, indent=1))
        return
    if not summary["finished"]:
        print(f"{out}: interrupted after {summary['steps']} steps; go on with --resume")
        return
    print(f"{summary['weights']}: {summary['steps']} steps, {summary['views']} views")
    if summary["scores"]:
        print(", ".join(f"{name} {value:.2f}" for name, value in summary["scores"].items()))


def _learned(sequence: Sequence, weights: str) -> Detections:
    from egocap.commandline import progress
    from egocap.detect.detector import Detector, detect
    from egocap.detect.weights import open_weights

    detector = Detector(sequence.rig, open_weights(weights or None))
    with progress("detect", len(sequence)) as advance:
        return detect(sequence, detector, on_frames=advance)


def _print_detections(
    path: Path, found: Detections, views: tuple[str, ...], seconds: float, as_json: bool
) -> None:
    from egocap.detect.detector import missing_pictures

    frames = len(found.times)
    summary = {
        "detections": str(path), "source": found.source, "frames": frames,
        "frames_per_second": frames / seconds,
        "detections_per_frame": float(found.valid.sum()) / frames,
        "frames_without": dict(zip(views, missing_pictures(found), strict=True)),
    }  # fmt: skip
    if as_json:
        print(json.dumps(summary, indent=1))
        return
    print(f"{path}: {frames} frames at {summary['frames_per_second']:.1f} frames/s, "
          f"{summary['detections_per_frame']:.1f} detections a frame of {len(views)} x 18, by "
          f"{found.source}")  # fmt: skip


def _print_calibration(path: Path, found: dict[str, Any], as_json: bool) -> None:
    import math

    if as_json:
        print(json.dumps(found, indent=1))
        return
    seen, hidden = (math.exp(found[f"log_sigma_{kind}"]) for kind in ("seen", "hidden"))
    print(f"{path}: spread times {seen:.2f} where joints are seen, {hidden:.2f} where hidden; "
          f"confidence from {found['scale']:.2f} x margin {found['offset']:+.2f}")  # fmt: skip
