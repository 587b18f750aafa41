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
    from egocap.view.live_view import Watcher

LIVE = TrackerConfig(smoothing="none")


@app.command
def live(
    sources: Positional[tuple[str, ...]],
    rig: Path,
    body: Path,
    out: Path | None = None,
    weights: Path | None = None,
    seconds: float = float("inf"),
    colour_only: bool = False,
    start: str = "rest",
    view: bool = False,
    port: int = 8642,
    record: Path | None = None,
    settings: Annotated[TrackerConfig, tyro.conf.OmitArgPrefixes] = LIVE,
    config: Path | None = None,
    advanced: bool = False,
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
        colour_only: follow the upper body by colour, without a detector, from the pose --start.
        start: pose of the first pictures for --colour-only: a name (rest, arms forward, arms bent,
            sitting, ...) or a track, whose first frame is taken.
        view: show views, pose and a three-dimensional view on a page for a browser of this machine.
        port: of that page; 0 takes any that is free.
        record: film of the same to write, mp4.
        settings: the tracker's settings; past frames alone count.
        config: TOML file of the tracker's settings; flags override it.
        advanced: take all settings of the tracker as flags; --advanced --help lists them.
        json: print the summary as JSON.
    """
    from egocap.body.proportions import Proportions
    from egocap.cameras.rig_files import load_rig
    from egocap.data.track import save_track

    loaded = load_rig(rig)
    if len(sources) != len(loaded.mounts):
        raise InputError(f"{len(sources)} sources", valid=f"{len(loaded.mounts)}, one a view")
    if colour_only and (weights is not None or settings != LIVE):
        raise InputError("--colour-only with weights or settings of the tracker", valid="neither")
    if not colour_only and start != "rest":
        raise InputError(f"--start '{start}' without --colour-only", valid="both or none")
    with ExitStack() as stack:
        watcher = _watcher(stack, loaded, view, port, record)
        request = _Request(sources, loaded, Proportions.load(body), seconds, watcher)
        if colour_only:
            report, tracker, made_by = _by_colour(stack, request, start)
        else:
            report, tracker, made_by = _by_detections(stack, request, weights, settings)
    if out is not None:
        save_track(out, report.track(tracker, made_by))
    _print_live(report, json)
    return DONE


@dataclass(frozen=True)
class _Request:
    sources: tuple[str, ...]
    rig: Rig
    person: Proportions
    seconds: float
    watcher: Watcher

    def opened(self, stack: ExitStack) -> list[Source]:
        """Sources that begin to run now and are closed with the stack."""
        from egocap.view.capture import Source

        found = []
        for name in self.sources:
            found.append(Source(name))
            stack.callback(found[-1].close)
        return found


def _by_detections(
    stack: ExitStack, request: _Request, weights: Path | None, config: TrackerConfig
) -> tuple[LiveReport, KnowsPerson, str]:
    from egocap.detect.detector import Detector
    from egocap.track.online import OnlineTracker
    from egocap.view.capture import follow_live

    tracker = OnlineTracker(request.rig, request.person, config)
    detector = Detector(request.rig, weights)
    opened = request.opened(stack)
    report = follow_live(opened, detector, tracker, request.seconds, request.watcher)
    return report, tracker, detector.source


def _by_colour(
    stack: ExitStack, request: _Request, start: str
) -> tuple[LiveReport, KnowsPerson, str]:
    from egocap.track.colour_tracker import ColourTracker
    from egocap.view.capture import first_pictures, follow_pictures

    tracker = ColourTracker(request.rig, request.person, _start_pose(start))
    tracker.learn(first_pictures(request.sources))
    opened = request.opened(stack)
    report = follow_pictures(opened, tracker.step, request.seconds, request.watcher)
    return report, tracker, f"colour only from '{start}'"


def _watcher(stack: ExitStack, rig: Rig, view: bool, port: int, record: Path | None) -> Watcher:
    """Who is shown the poses; what it opens is closed with the stack."""
    from egocap.view.live_page import PictureStream
    from egocap.view.live_view import Watcher
    from egocap.view.video import Film

    film = None if record is None else stack.enter_context(Film(record))
    stream = None
    if view:
        stream = PictureStream(port)
        stack.callback(stream.close)
        print(f"see {stream.url}", file=sys.stderr, flush=True)
    return Watcher(rig, stream, film)


def _start_pose(start: str) -> Float[Array, "37"]:
    from egocap.data.track import load_track
    from egocap.pose.initial_poses import STARTS, start_poses

    if start in STARTS:
        return start_poses()[list(STARTS).index(start)]
    if not start.endswith(".npz"):
        raise InputError(f"no starting pose '{start}'", valid=(*STARTS, "a track, .npz"))
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
