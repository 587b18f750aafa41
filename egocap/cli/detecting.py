"""Commands of the detector: detect, calibrate-detector, train and adapt."""

from __future__ import annotations

import json
import os
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from egocap.adaptation.config import AdaptOptions
from egocap.cli.checks import check_weights
from egocap.cli.many import are_several, print_report, run_several
from egocap.cli.registry import app
from egocap.commandline import DONE, INTERRUPTED
from egocap.detect.train.config import FOR_A_RIG, RunConfig, TrainingConfig
from egocap.errors import InputError, require
from egocap.locks import holding, locks, require_distinct
from egocap.options import several

if TYPE_CHECKING:
    from egocap.adaptation.adapt import Adaptation
    from egocap.data.detections import Detections
    from egocap.detect.train.trainer import Outcome
    from egocap.execution.recording_task import Report


@app.command
def detect(
    sequences: Positional[Annotated[tuple[str, ...], several("SEQUENCE")]],
    /,
    out: Path,
    weights: Path | None = None,
    engine: str = "auto",
    threads: int | None = None,
    frames: int | None = None,
    workers: int | None = None,
    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
    json: bool = False,
) -> int:
    """Detect 18 body parts in every view of sequences.

    Over several, run the same command again to continue an interrupted run.

    Args:
        sequences: folders of sequences; with --workers or --cluster also folders that hold some.
        out: detections to write, npz; of several sequences, and with --workers or --cluster, the
            folder of theirs.
        weights: detector weights, safetensors; those shipped by default.
        engine: auto (the fastest installed), onnxruntime or openvino (an extra), each also with
            -int8 (8-bit integers), torch or cuda.
        threads: threads of the network; all cores by default, shared among the workers.
        frames: only so many frames, from the first.
        workers: processes, each with a sequence at a time; 0, the default: this one.
        cluster: run on the workers of this Dask scheduler, e.g. tcp://host:8786.
        json: print the summary as JSON.
    """
    settings = {"weights": weights, "engine": engine, "frames": frames}
    if not are_several(sequences, several := (workers, cluster)):
        require_distinct({"out": out}, {"weights": weights})
        with holding(out):
            report = _detect(sequences, out, threads, **settings)
        print_report("detections", out, report, json)
        return DONE
    from egocap.execution.recordings import find_recordings

    if cluster is None:
        check_weights(weights)
    if workers and cluster is None and threads is None:
        from egocap.detect.engine import available_cores

        threads = max(1, available_cores() // workers)
    return run_several(
        "detect", partial(_detect, threads=threads), settings,
        find_recordings(sequences, ".detections.npz"), out, several, strict=False, as_json=json,
    )  # fmt: skip


def _detect(
    sources: tuple[str, ...], out: Path, threads: int | None, weights: Path | None, engine: str,
    frames: int | None,
) -> Report:  # fmt: skip
    """Detect in one sequence and write the detections."""
    import time

    from egocap.commandline import progress
    from egocap.data.detections import save_detections
    from egocap.data.sequence import open_sequence
    from egocap.detect.detector import Detector

    (sequence,) = sources
    opened = open_sequence(sequence)
    detector = Detector(opened.rig, weights, engine, threads)  # type: ignore[arg-type]
    started = time.perf_counter()
    with progress("detect", frames or len(opened)) as advance:
        found = detector.detect(opened, frames=frames, on_frames=advance)
    seconds = time.perf_counter() - started
    save_detections(out, found)
    return _report(found, opened.rig.views, seconds)


@app.command
@locks("out", replaces="weights")
def calibrate_detector(
    data: Positional[Annotated[tuple[Path, ...], several("SEQUENCE")]],
    /,
    weights: Path,
    out: Path,
    store: Path | None = None,
    json: bool = False,
) -> int:
    """Fit a detector's confidence and sigma on footage not used in training.

    Writes the same weights with the fitted calibration. On this machine, detection with them then
    runs in 8-bit integers, two to three times as fast.

    Args:
        data: sequences, or folders of sequences.
        weights: detector weights to calibrate, safetensors.
        out: weights to write, safetensors; may be the same file.
        store: folder for canonical views of the data; a temporary one by default.
        json: print the calibration as JSON.
    """
    import tempfile

    from egocap.detect.train.calibrate import calibrate
    from egocap.detect.weights import open_weights

    with tempfile.TemporaryDirectory() as temporary:
        found = calibrate(open_weights(weights), data, store or Path(temporary), out)
    _print_calibration(out, found.to_dict(), json)
    return DONE


@app.command
def train(
    run: Annotated[RunConfig, tyro.conf.OmitArgPrefixes],
    training: Annotated[TrainingConfig, tyro.conf.OmitArgPrefixes] = TrainingConfig(),  # noqa: B008
    rig: Path | None = None,
    json: bool = False,
) -> int:
    """Train a detector on footage with annotations.

    Writes detector.safetensors, curves.png, log.csv and validation.csv into the folder of the run.
    SIGTERM and Ctrl-C stop it after a step; --resume continues it. All GPUs of the machine take
    part; start several machines with torchrun.

    Args:
        run: what to train.
        training: how to train.
        rig: not available here; `egocap-eval train` simulates footage for a rig and trains on it.
        json: print the summary as JSON.
    """
    import subprocess
    import sys

    if rig is not None:
        raise InputError(f"egocap train does not simulate footage{FOR_A_RIG}")
    require("torch", "train")
    from egocap.detect.train import run as runs

    command = runs.command_for_devices(sys.argv[1:])
    if command is not None:
        return subprocess.call(command)
    runs.join_processes()
    first = os.environ.get("RANK", "0") == "0"  # of several processes: it writes and prints
    with ExitStack() as stack:
        if first:
            stack.enter_context(holding(run.out, folder=True))
        outcome = runs.train_detector(run, training)
    if first:
        _print_run(run, outcome, json)
    return DONE if outcome.finished else INTERRUPTED


@app.command
@locks("out", folder=True)
def adapt(
    footage: Positional[Annotated[tuple[Path, ...], several("SEQUENCE")]],
    /,
    out: Path,
    options: Annotated[AdaptOptions, tyro.conf.OmitArgPrefixes] = AdaptOptions(),  # noqa: B008
    json: bool = False,
) -> int:
    """Adapt the detector to footage of your own cameras, without annotations.

    The offline tracker labels the footage, and the detector is trained on those joints of which
    the tracker is sure. Writes detector.safetensors, for --weights of other commands, if it is
    better on stretches that were held out. The same command goes on where an interrupted one
    stopped.

    Args:
        footage: sequences of one wearer, or folders of mocap.
        out: folder of the results.
        options: what is known of the wearer, and how long to train.
        json: print the summary as JSON.
    """
    from egocap.adaptation.adapt import adapt as adapted
    from egocap.cli.footage import steps

    with ExitStack() as stack:
        result = adapted(footage, out, options, steps(stack))
    if result is None:
        print(f"{out}: interrupted; the same command goes on")
        return INTERRUPTED
    _print_adaptation(result, json)
    return DONE


def _print_adaptation(result: Adaptation, as_json: bool) -> None:
    if as_json:
        print(json.dumps(result.to_dict(), indent=1))
        return
    print(f"{result.images} images, {100 * result.labelled:.0f} % of the joints in view labelled, "
          f"{100 * result.corrected:.1f} % of them elsewhere than detected")  # fmt: skip
    print(
        f"held-out stretches, PCK over 0 to 20 px: {result.before.mean():.1f} -> "
        f"{result.after.mean():.1f} (gain {result.gain:+.1f} +- {result.gain_error:.1f})"
    )
    print(f"{result.weights}: use it with --weights" if result.kept
          else "not better: go on with the starting weights")  # fmt: skip


def _print_run(run: RunConfig, outcome: Outcome, as_json: bool) -> None:
    from egocap.detect.train.run import summary, summary_text

    print(json.dumps(summary(run, outcome), indent=1) if as_json else summary_text(run, outcome))


def _report(found: Detections, views: tuple[str, ...], seconds: float) -> Report:
    from egocap.detect.detector import missing_pictures
    from egocap.execution.recording_task import Report

    frames = len(found.times)
    rate, per_frame = frames / seconds, float(found.valid.sum()) / frames
    summary = {
        "source": found.source, "frames": frames, "frames_per_second": rate,
        "detections_per_frame": per_frame,
        "frames_without": dict(zip(views, missing_pictures(found), strict=True)),
    }  # fmt: skip
    line = (f"{frames} frames at {rate:.1f} frames/s, {per_frame:.1f} detections a frame of "
            f"{len(views)} x 18, by {found.source}")  # fmt: skip
    return Report(summary, (line,))


def _print_calibration(path: Path, found: dict[str, Any], as_json: bool) -> None:
    import math

    if as_json:
        print(json.dumps(found, indent=1))
        return
    seen, hidden = (math.exp(found[f"log_sigma_{kind}"]) for kind in ("seen", "hidden"))
    print(f"{path}: sigma times {seen:.2f} for visible joints, {hidden:.2f} for hidden; "
          f"confidence from {found['scale']:.2f} x margin {found['offset']:+.2f}")  # fmt: skip
