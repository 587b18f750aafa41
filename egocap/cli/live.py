"""The command `egocap live`."""

from __future__ import annotations

import json as jsons
import sys
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE, INTERRUPTED
from egocap.errors import InputError, MachineError
from egocap.locks import locks
from egocap.options import several
from egocap.pose.config import TrackerConfig
from egocap.view.capture import CameraSettings

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from egocap.body.proportions import Proportions
    from egocap.cameras.rig import Rig
    from egocap.track.online import PoseEstimate
    from egocap.view.feeds import Feed, Images
    from egocap.view.live_run import LiveReport, OnPose
    from egocap.view.live_scene import LiveViewer
    from egocap.view.live_view import PoseDisplay
    from egocap.view.pose_log import PoseLog

LIVE = TrackerConfig(smoothing="fixed-lag")
CAMERAS = CameraSettings()
_LAST_PORT = 65_535


@dataclass(frozen=True)
class LiveOptions:
    """How long to track, by what, and what to show."""

    weights: Path | None = None
    """Weights of the learned detector; the shipped ones by default."""
    seconds: float = float("inf")
    """Stop after this time."""
    realtime: bool = False
    """Play video files by the clock and skip frames that come too fast, as with cameras."""
    world: bool = False
    """Find the head in the world, too, from the same pictures: z up, the floor at height 0. No
    loop is closed, as only past pictures are known."""
    self_calibration: bool = True
    """With --world: correct the rig, and find lags and rolling shutters, from the first pictures
    that move. The pose relative to the head uses the rig file as it is (correct-rig writes one)."""
    colour_only: bool = False
    """Track the body by its appearance, without a detector, from the pose --start."""
    start: str = "rest"
    """Initial pose for --colour-only: a name (rest, arms forward, arms bent, sitting, ...) or a
    track, whose first frame is used."""
    view: bool = False
    """Show the views, the pose and a 3-D view on a web page served on this machine."""
    port: int = 8642
    """Port of that page; 0 picks a free one."""
    viewer: Literal["window", "browser"] | None = None
    """Show the same in the Rerun viewer (extra view), with a time line: in a window of its own, or
    for a browser on this machine."""
    record: Path | None = None
    """Video of the same to write, mp4."""


@app.command
@locks("out")
def live(
    sources: Positional[Annotated[tuple[str, ...], several("CAMERA|VIDEO")]] = (),
    rig: Path | None = None,
    body: str | None = None,
    out: Path | None = None,
    run: Annotated[LiveOptions, tyro.conf.OmitArgPrefixes] = LiveOptions(),
    cameras: Annotated[CameraSettings, tyro.conf.OmitArgPrefixes] = CAMERAS,
    settings: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = LIVE,
    list: bool = False,
    json: bool = False,
) -> int:
    """Track live from cameras or video files, one per view, in the order of the rig.

    From cameras, each pose uses the newest pictures; older ones are skipped, so that the tracker
    does not fall behind. Of video files every frame is used, at the time that the file states.
    Ctrl-C ends the run and keeps what was tracked.

    Args:
        sources: Camera numbers or video files, one per view.
        rig: Rig file of the cameras.
        body: Proportions of the wearer: a body file, or average:HEIGHT in metres.
        out: Track to write at the end, npz.
        run: How long to track, by what, and what to show.
        cameras: What to ask of the cameras.
        settings: Settings of the tracker, which uses past frames only.
        list: List the cameras of this machine and do nothing else.
        json: Print the summary as JSON.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap.data.track import save_track
    from egocap.detect.train.interruption import Interruption
    from egocap.fitting.wearer import find_body
    from egocap.view.feeds import open_feed, recorded
    from egocap.view.live_run import LiveReport
    from egocap.view.pose_log import pose_log

    if list:
        return _print_cameras(json)
    if rig is None or body is None:
        missing = [name for name, value in (("--rig", rig), ("--body", body)) if value is None]
        valid = "--rig FILE and --body FILE or average:HEIGHT, or --list"
        raise InputError(f"live without {' and '.join(missing)}", valid=valid)
    loaded = load_rig(rig)
    _check(sources, len(loaded.mounts), run, settings)
    person = find_body(body)
    for path in (out, run.record):
        if path is not None:
            _require_writable(path)
    report = LiveReport()
    log = nullcontext() if out is None else pose_log(out)
    with log as kept, Interruption() as stop, ExitStack() as stack:
        display = _open_display(stack, loaded, run)
        follow = _by_colour if run.colour_only else _by_detections
        method, prepared = follow(stack, sources, loaded, person, run, cameras, settings)
        feed = open_feed(stack, sources, cameras, lambda: stop.requested, run.seconds,
                         realtime=run.realtime)  # fmt: skip
        try:
            prepared(feed, display if kept is None else _keeping(display, kept), report)
        finally:  # what was tracked is kept, whatever ended the run
            if kept is not None and report.poses:
                save_track(kept.path, kept.take(person, method, report))
    if out is not None and not report.poses:
        raise MachineError("no pictures came, so that there is nothing to write")
    _print_live(report, json)
    every = recorded(sources, realtime=run.realtime)
    return INTERRUPTED if stop.requested and every else DONE


def _keeping(display: PoseDisplay, kept: PoseLog) -> OnPose:
    """Show a pose, and keep it."""

    def give(pose: PoseEstimate, images: Images) -> None:
        kept.append(pose)
        display(pose, images)

    return give


Follow = Callable[["Feed", "OnPose", "LiveReport"], "LiveReport"]


def _check(sources: tuple[str, ...], views: int, run: LiveOptions, settings: TrackerConfig) -> None:
    """Raise InputError for impossible options, and for those that exclude each other."""
    from egocap.view.feeds import check_sources

    check_sources(sources, views)
    if not run.seconds > 0.0:
        raise InputError(f"--seconds {run.seconds:g}", valid="above 0")
    if not 0 <= run.port <= _LAST_PORT:
        raise InputError(f"--port {run.port}", valid=f"0 to {_LAST_PORT}")
    if run.colour_only and (run.weights is not None or settings != LIVE):
        raise InputError("--colour-only uses neither --weights nor tracker settings")
    if run.colour_only and run.world:
        raise InputError("--world requires a detector", valid="it without --colour-only")
    if not run.self_calibration and not run.world:
        raise InputError("--no-self-calibration without --world", valid="it with --world")
    if run.world and views < 2:
        raise InputError("--world requires two views, whose distance tells metres",
                         valid="a rig of two views or more")  # fmt: skip
    if not run.colour_only and run.start != "rest":
        raise InputError(f"--start '{run.start}' requires --colour-only")


def _require_writable(path: Path) -> None:
    """Raise an error now, not after the run, for a file that cannot be written."""
    from tempfile import TemporaryFile

    from egocap.files import disk_errors, make_folder

    make_folder(path.parent)
    if path.is_dir():
        raise InputError(f"{path} is a folder", valid="the name of a file")
    with disk_errors(path), TemporaryFile(dir=path.parent):
        pass


def _by_detections(
    stack: ExitStack, sources: tuple[str, ...], rig: Rig, person: Proportions,
    options: LiveOptions, cameras: CameraSettings, config: TrackerConfig,
) -> tuple[str, Follow]:  # fmt: skip
    from egocap.detect.detector import Detector
    from egocap.track.online import OnlineTracker
    from egocap.view.feeds import recorded
    from egocap.view.live_run import follow_live, warm_up

    tracker, head = OnlineTracker(rig, person, config), None
    if options.world:
        from egocap.head_pose.online import OnlineHeadPose
        from egocap.odometry.config import OdometryConfig

        settings = OdometryConfig(self_calibration=options.self_calibration)
        waits = recorded(sources, realtime=options.realtime)
        head = OnlineHeadPose(rig, settings, waits=waits)
        stack.callback(head.close)
        head.warm_up()
    detector = Detector(rig, options.weights, streams=1)
    warm_up(detector, tracker)
    return (
        detector.source,
        lambda feed, on_pose, report: follow_live(feed, detector, tracker, on_pose, report, head),
    )


def _by_colour(
    _: ExitStack, sources: tuple[str, ...], rig: Rig, person: Proportions, options: LiveOptions,
    cameras: CameraSettings, config: TrackerConfig,
) -> tuple[str, Follow]:  # fmt: skip
    from egocap.track.colour_tracker import ColourTracker
    from egocap.view.capture import first_pictures
    from egocap.view.live_run import follow_pictures

    tracker = ColourTracker(rig, person, _start_pose(options.start))
    tracker.learn(first_pictures(sources, cameras))
    return (
        f"colour only from '{options.start}'",
        lambda feed, on_pose, report: follow_pictures(feed, tracker, on_pose, report),
    )


def _open_display(stack: ExitStack, rig: Rig, options: LiveOptions) -> PoseDisplay:
    """The display of poses; its page and video are closed with the stack."""
    from egocap.view.live_page import PictureStream
    from egocap.view.live_view import PoseDisplay
    from egocap.view.video import VideoFile

    video = None if options.record is None else stack.enter_context(VideoFile(options.record))
    stream = None
    if options.view:
        stream = PictureStream(options.port)
        stack.callback(stream.close)
        print(f"see {stream.url}", file=sys.stderr, flush=True)
    return PoseDisplay(rig, stream, video, _open_viewer(stack, rig, options))


def _open_viewer(stack: ExitStack, rig: Rig, options: LiveOptions) -> LiveViewer | None:
    if options.viewer is None:
        return None
    from egocap.view.live_scene import LiveViewer

    viewer = LiveViewer(rig, options.viewer, world=options.world)
    stack.callback(viewer.close)
    if viewer.url is not None:
        print(f"see {viewer.url}", file=sys.stderr, flush=True)
    return viewer


def _start_pose(start: str) -> Float[Array, "37"]:
    from egocap.data.track import load_track
    from egocap.pose.initial_poses import STARTS, start_poses

    if start in STARTS:
        return start_poses()[list(STARTS).index(start)]
    if not start.endswith(".npz"):
        raise InputError(f"no initial pose '{start}'", valid=(*STARTS, "a track, .npz"))
    return load_track(start).angles[0]


def _print_live(report: LiveReport, as_json: bool) -> None:
    from egocap.head_pose.rig_correction import correction_lines

    summary = report.summary()
    if as_json:
        print(jsons.dumps(summary, indent=1))
        return
    latency = "latency unknown"
    if report.latency_ms is not None:
        latency = f"latency {report.latency_ms[0]:.0f} ms (95 %: {report.latency_ms[1]:.0f})"
    print(f"{summary['poses']} poses, {summary['poses_per_second']:.1f} a second, {latency}, "
          f"{summary['skipped_pictures']} pictures skipped, "
          f"{summary['missing_pictures']} missing; "
          + ", ".join(f"{stage} {summary[f'{stage}_ms']:.0f}" for stage in report.stages)
          + " ms")  # fmt: skip
    if report.world:
        print(f"head in the world in {report.world['posed']} of {report.world['frames']} frames")
        for reason, frames in report.world["without"].items():
            print(f"no head pose in {frames} frames: {reason}")
        for line in correction_lines(report.world["self_calibration"]):
            print(line)


def _print_cameras(as_json: bool) -> int:
    from egocap.view.capture import list_cameras

    found = list_cameras()
    if as_json:
        print(jsons.dumps([vars(camera) for camera in found], indent=1))
        return DONE
    for camera in found:
        shown = "in use, or not a camera of pictures"
        if camera.size is not None:
            shown = f"{camera.size[0]} x {camera.size[1]} at {camera.fps:g} Hz"
        print(f"{camera.number}: {camera.name}, {shown}")
    if not found:
        print("no cameras")
    return DONE
