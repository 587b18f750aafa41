"""The command `egocap live`."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

    from egocap.body.proportions import Proportions
    from egocap.cameras.rig import Rig
    from egocap.view.capture import KnowsPerson, LiveReport, Source
    from egocap.view.live_view import PoseDisplay

LIVE = TrackerConfig(smoothing="none")


@dataclass(frozen=True)
class LiveOptions:
    """How long to track, by what, and what to show."""

    weights: Path | None = None
    """Weights of the learned detector; the shipped ones by default."""
    seconds: float = float("inf")
    """Stop after this time."""
    colour_only: bool = False
    """Track the upper body by colour, without a detector, from the pose --start."""
    start: str = "rest"
    """Initial pose for --colour-only: a name (rest, arms forward, arms bent, sitting, ...) or a
    track, whose first frame is used."""
    view: bool = False
    """Show the views, the pose and a 3-D view on a web page served on this machine."""
    port: int = 8642
    """Port of that page; 0 picks a free one."""
    record: Path | None = None
    """Video of the same to write, mp4."""


@app.command
def live(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    body: Path,
    out: Path | None = None,
    run: Annotated[LiveOptions, tyro.conf.OmitArgPrefixes] = LiveOptions(),
    settings: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = LIVE,
    json: bool = False,
) -> int:
    """Track live from cameras or video files, one per view, in the order of the rig.

    Each pose uses the newest pictures; older ones are skipped, so that the tracker does not fall
    behind. A video file plays at its own frame rate.

    Args:
        sources: Camera numbers or video files, one per view.
        rig: Rig file of the cameras.
        body: Body file of the wearer.
        out: Track to write at the end, npz.
        run: How long to track, by what, and what to show.
        settings: Settings of the tracker, which uses past frames only.
        json: Print the summary as JSON.
    """
    from egocap.body.proportions import Proportions
    from egocap.cameras.rig_files import load_rig
    from egocap.data.track import save_track

    loaded = load_rig(rig)
    if len(sources) != len(loaded.mounts):
        raise InputError(f"{len(sources)} sources", valid=f"{len(loaded.mounts)}, one per view")
    if run.colour_only and (run.weights is not None or settings != LIVE):
        raise InputError("--colour-only uses neither --weights nor tracker settings")
    if not run.colour_only and run.start != "rest":
        raise InputError(f"--start '{run.start}' requires --colour-only")
    person = Proportions.load(body)
    with ExitStack() as stack:
        display = _open_display(stack, loaded, run)
        if run.colour_only:
            report, tracker, method = _track_by_colour(stack, sources, loaded, person, run, display)
        else:
            report, tracker, method = _track_by_detections(
                stack, sources, loaded, person, run, display, settings
            )
    if out is not None:
        save_track(out, report.track(tracker, method))
    _print_live(report, json)
    return DONE


def _track_by_detections(
    stack: ExitStack, sources: tuple[str, ...], rig: Rig, person: Proportions,
    options: LiveOptions, display: PoseDisplay, config: TrackerConfig,
) -> tuple[LiveReport, KnowsPerson, str]:  # fmt: skip
    from egocap.detect.detector import Detector
    from egocap.track.online import OnlineTracker
    from egocap.view.capture import follow_live

    tracker = OnlineTracker(rig, person, config)
    detector = Detector(rig, options.weights)
    opened = _open_sources(stack, sources)
    report = follow_live(opened, detector, tracker, options.seconds, display)
    return report, tracker, detector.source


def _track_by_colour(
    stack: ExitStack, sources: tuple[str, ...], rig: Rig, person: Proportions,
    options: LiveOptions, display: PoseDisplay,
) -> tuple[LiveReport, KnowsPerson, str]:  # fmt: skip
    from egocap.track.colour_tracker import ColourTracker
    from egocap.view.capture import first_pictures, follow_pictures

    tracker = ColourTracker(rig, person, _start_pose(options.start))
    tracker.learn(first_pictures(sources))
    opened = _open_sources(stack, sources)
    report = follow_pictures(opened, tracker.step, options.seconds, display)
    return report, tracker, f"colour only from '{options.start}'"


def _open_sources(stack: ExitStack, names: tuple[str, ...]) -> list[Source]:
    """Sources that start to run now and are closed with the stack."""
    from egocap.view.capture import Source

    found = []
    for name in names:
        found.append(Source(name))
        stack.callback(found[-1].close)
    return found


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
    return PoseDisplay(rig, stream, video)


def _start_pose(start: str) -> Float[Array, "37"]:
    from egocap.data.track import load_track
    from egocap.pose.initial_poses import STARTS, start_poses

    if start in STARTS:
        return start_poses()[list(STARTS).index(start)]
    if not start.endswith(".npz"):
        raise InputError(f"no initial pose '{start}'", valid=(*STARTS, "a track, .npz"))
    return load_track(start).angles[0]


def _print_live(report: LiveReport, as_json: bool) -> None:
    middle, late = report.latency_ms
    summary = {"poses": len(report.poses), "skipped_pictures": report.skipped,
               "latency_ms": middle, "latency_95_ms": late}  # fmt: skip
    if as_json:
        print(json.dumps(summary, indent=1))
    else:
        print(f"{len(report.poses)} poses, latency {middle:.0f} ms (95 %: {late:.0f}), "
              f"{report.skipped} pictures skipped")  # fmt: skip
