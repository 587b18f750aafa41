"""The command `egocap track`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from egocap.body.labels import LABELS
from egocap.cli.checks import check_body, check_head_pose, check_rig
from egocap.cli.compile_ahead import compiling_ahead
from egocap.cli.many import are_several, print_report, run_several
from egocap.cli.registry import app
from egocap.commandline import DONE, MISSED, progress
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.locks import holding, require_distinct
from egocap.options import several
from egocap.paper.config import SolverName
from egocap.pose.config import TrackerConfig

if TYPE_CHECKING:
    from egocap.data.track import Track
    from egocap.execution.recording_task import Report

ENDING = ".track.npz"
"""Of the names of tracks of several sequences."""


@dataclass(frozen=True)
class _Tracking:
    """What the result depends on beside the sequence."""

    detections: str
    solver: SolverName
    settings: TrackerConfig
    seed: int
    body: str | None
    rig: Path | None
    head_pose: Path | None
    mount_drift: bool


@app.command
def track(
    sequences: Positional[Annotated[tuple[str, ...], several("SEQUENCE")]],
    /,
    out: Path,
    detections: str = "learned",
    solver: SolverName = "fast",
    settings: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = TrackerConfig(),  # noqa: B008
    seed: int = 0,
    body: str | None = None,
    rig: Path | None = None,
    save_detections: Path | None = None,
    head_pose: Path | None = None,
    mount_drift: bool = False,
    strict: bool = False,
    workers: int | None = None,
    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None,
    json: bool = False,
) -> int:
    """Recover 37 joint angles in every frame of sequences from detections in both views.

    The tracker is given detections, the rig and the person's proportions; never the truth. Over
    several sequences, run the same command again to continue an interrupted run.

    Args:
        sequences: folders of sequences; with --workers or --cluster also folders that hold some.
        out: track to write, npz; of several sequences, and with --workers or --cluster, the folder
            of theirs.
        detections: where detections come from: the learned detector (learned:FILE for other weights
            than the shipped); simulated:SIGMA[,outliers=P][,occluded=keep|drop] draws them from the
            truth, SIGMA in pixels at 640 x 512; or a file of detections, or the folder that
            `egocap detect` wrote of several sequences.
        solver: fast: second order, all settings; reference: the paper's 200 gradient steps over
            all pixels; stochastic: its 50 steps over random pixels. Of the settings, the paper's
            solvers have the smoothing alone.
        settings: the tracker's settings.
        seed: seed of simulated detections.
        body: the person's proportions: a file of fit-body, average:HEIGHT, fit or fit:HEIGHT (from
            the first 20 s); by default the sequence's own, which footage does not have.
        rig: rig file in place of the sequence's own rig, as fit-rig writes it.
        save_detections: also write the detections used, npz; of a single sequence.
        head_pose: where the head was, as you know it from elsewhere: npz with `time` (s) and
            `T_world_head` (4 x 4), z up; the track is then in that world, too, with contacts, and
            planted feet keep their place. Frames in a gap of the poses stay in the head frame.
        mount_drift: follow a rig that slowly slips on the head, and say when it jumped; 10 s of
            footage or more, twice the time; solver fast, without head_pose.
        strict: exit with 3 if detections, rig and body do not fit each other; the track is written.
        workers: processes, each with a sequence at a time; 0, the default: this one.
        cluster: run on the workers of this Dask scheduler, e.g. tcp://host:8786.
        json: print the summary as JSON.
    """
    if mount_drift and (solver != "fast" or head_pose is not None):
        raise InputError("mount drift with another solver or head poses",
                         valid="--solver fast, no --head-pose")  # fmt: skip
    how = _Tracking(detections, solver, settings, seed, body, rig, head_pose, mount_drift)
    if cluster is None:
        check_body(body)
        check_rig(rig)
        check_head_pose(head_pose)
    if not are_several(sequences, several := (workers, cluster)):
        outputs = {"out": out, "save_detections": save_detections}
        outputs = {name: path for name, path in outputs.items() if path is not None}
        require_distinct(outputs, {"detections": detections, "body": body, "rig": rig,
                                   "head_pose": head_pose})  # fmt: skip
        with ExitStack() as held:
            for path in sorted(outputs.values()):
                held.enter_context(holding(path))
            if solver == "fast" and settings.checks_appearance:
                held.enter_context(compiling_ahead())
            report = _track(sequences, out, how, save_detections)
        print_report("track", out, report, json)
        return MISSED if strict and report.missed else DONE
    if save_detections is not None:
        raise InputError("--save-detections of several sequences",
                         valid="first `egocap detect`, then --detections DIR")  # fmt: skip
    from egocap.execution.recordings import find_recordings

    return run_several("track", _track, {"how": how}, find_recordings(sequences, ENDING), out,
                       several, strict=strict, as_json=json)  # fmt: skip


def _track(
    sources: tuple[str, ...], out: Path, how: _Tracking, save_detections: Path | None = None
) -> Report:
    """Track one sequence and write the track."""
    from egocap.cameras.rig_files import load_rig
    from egocap.data import detections as detection_file
    from egocap.data.head_pose import read_head_poses
    from egocap.data.sequence import open_sequence
    from egocap.data.track import save_track
    from egocap.fitting.wearer import find_body
    from egocap.paper.tracker import make_tracker

    (sequence,) = sources
    opened = open_sequence(sequence)
    if how.body is None:
        _ = opened.body  # before anything takes time
    cameras = opened.rig if how.rig is None else load_rig(how.rig)
    source = how.detections
    if Path(source).is_dir():
        source = str(Path(source) / f"{out.name.removesuffix(ENDING)}.detections.npz")
    found = detections_from(opened, source, how.seed, cameras)
    proportions = opened.body if how.body is None else find_body(how.body, cameras, found)
    heads = None if how.head_pose is None else read_head_poses(how.head_pose, found.times)
    drift = None
    passes = 2 if how.mount_drift else 1
    with progress("track", passes * len(found.times)) as advance:
        if how.mount_drift:
            from egocap.fitting.mount_drift import track_with_drift

            result, drift = track_with_drift(
                found, cameras, proportions, how.settings, opened.images, advance
            )
        else:
            tracker = make_tracker(cameras, proportions, how.solver, how.settings)
            result = tracker.track(found, opened.images, heads, advance)
    # So that no other sequence is scored with it, and scores name the body.
    origin = {"sequence": opened.manifest.config_sha256, "body": how.body or "sequence"}
    result = replace(result, config=result.config | origin)
    if save_detections is not None:
        detection_file.save_detections(save_detections, found)
    save_track(out, result)
    return _report(result, [] if drift is None else drift.lines())


def _report(result: Track, drift: Sequence[str]) -> Report:
    from egocap.execution.recording_task import Report
    from egocap.track.consistency import warning_of

    rate = 1.0 / result.seconds_per_frame
    summary: dict[str, Any] = {
        "frames": len(result.times), "frames_per_second": rate,
        "converged": int(result.converged.sum()),
        "detections_per_frame": float(result.detections_used.mean()),
        "consistency": result.config["consistency"],
    }  # fmt: skip
    if result.hidden is not None:
        from egocap.data.track import HIDDEN

        shares = {name: float((result.hidden == code).mean()) for code, name in enumerate(HIDDEN)}
        summary["shares_of_joints"] = shares
    if result.in_world is not None:
        summary["frames_in_world"] = int(result.in_world.sum())
    if "mount_drift" in result.config:
        summary["mount_drift"] = result.config["mount_drift"]
    views = "" if result.hidden is None else f" of {result.hidden.shape[1]} x {len(LABELS)}"
    lines = [f"{summary['frames']} frames tracked, {rate:.0f} frames/s on one core, "
             f"{summary['converged']} converged, {summary['detections_per_frame']:.1f} detections "
             f"a frame{views}"]  # fmt: skip
    if warning := warning_of(result):
        lines.append(f"warning: {warning}")
    if result.in_world is not None:
        lines.append(_world_summary(result))
    return Report(summary, (*lines, *drift), warning is not None)


def _world_summary(result: Track) -> str:
    """The frames in the world, those in gaps, and how often the feet touch the ground."""
    assert result.in_world is not None
    there, frames = int(result.in_world.sum()), len(result.in_world)
    text = f"in the world: {there} frames"
    if there < frames:
        text += f"; {frames - there} without a head pose nearby stay in the head frame"
    if result.standing is not None:
        planted = result.standing[result.in_world].mean(0)
        text += (
            f"; feet on the ground {100 * planted[0]:.0f} (left), {100 * planted[1]:.0f} % (right)"
        )
    return text
