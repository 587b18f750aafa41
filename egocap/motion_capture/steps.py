"""Stages of a run that make numbers: detections, the rig, the body, head poses and the track."""

from __future__ import annotations

import logging
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig, write_rig
from egocap.data.detections import Detections, load_detections, save_detections
from egocap.data.head_pose import read_head_poses
from egocap.data.sequence import Sequence as Recording
from egocap.data.sequence_writer import digest
from egocap.data.track import Track, load_track, save_track
from egocap.detect.detector import Detector
from egocap.detect.weights import open_weights
from egocap.errors import InputError
from egocap.files import sha256, write_json
from egocap.fitting.wearer import find_body
from egocap.footage.sources import Step
from egocap.head_pose.from_pictures import find_head_poses
from egocap.head_pose.rig_correction import correction_lines, search_rig
from egocap.motion_capture.body import fit_wearer
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.detecting import detect_in_pieces
from egocap.motion_capture.rig_search import load_search, write_search
from egocap.motion_capture.stages import Stages
from egocap.motion_capture.tracking import track_in_windows
from egocap.odometry.config import OdometryConfig
from egocap.odometry.self_calibration import RigSearch
from egocap.odometry.views import Views
from egocap.pose.config import TrackerConfig
from egocap.schema import read_json

log = logging.getLogger(__name__)


def detections(
    stages: Stages, sequence: Recording, options: MocapOptions, on_step: Step
) -> Detections:
    """Detections in all frames: detections.npz."""

    def write(path: Path) -> None:
        detector = Detector(sequence.rig, weights)
        pieces = stages.folder / f"detections-{digest(settings)[:8]}"
        advance = on_step("detect", len(sequence))
        save_detections(path, detect_in_pieces(sequence, detector, pieces, advance))
        shutil.rmtree(pieces)

    weights = open_weights(options.weights)
    settings = {"sequence": sequence.manifest.config_sha256, "weights": weights.sha256}
    return stages.run("detections.npz", settings, write, load_detections)


def rig(
    stages: Stages, sequence: Recording, options: MocapOptions, on_step: Step
) -> tuple[Rig, RigSearch | None]:
    """The rig as the surroundings tell it, or as given (rig.json), and the search for its errors.

    The search is None where none was made.
    """

    def write(path: Path) -> None:
        search = None
        if options.self_calibration and len(sequence.rig.mounts) > 1:
            advance = on_step("rig", 1)
            try:
                search = search_rig(sequence, Views.of(sequence.rig, OdometryConfig().width))
            except InputError as error:
                log.warning("%s: the rig file is taken as it is", error)
            advance(1)
        if search is not None and search.correction is not None:
            for line in correction_lines(search.correction.facts()):
                log.warning("%s", line)
        write_search(path, search)

    settings = {"sequence": sequence.manifest.config_sha256,
                "self_calibration": options.self_calibration}  # fmt: skip
    search = stages.run("rig-correction.json", settings, write,
                        lambda path: load_search(path, sequence.rig))  # fmt: skip
    correction = None if search is None else search.correction
    found = sequence.rig if correction is None else correction.rig(sequence.rig)
    rig = stages.run("rig.json", {}, lambda path: write_rig(path, found), load_rig,
                     after=("rig-correction.json",))  # fmt: skip
    return rig, search


def body(
    stages: Stages, rig: Rig, found: Detections, options: MocapOptions, on_step: Step
) -> tuple[Proportions, dict[str, Any]]:
    """Proportions (body.json), and the report of their fit; empty where they were given."""
    report = stages.folder / "body-report.json"

    def write(path: Path) -> None:
        if given is not None:
            given.save(path)
            write_json(report, {})
            return
        fit = fit_wearer(found, rig, options.height, on_step)
        fit.proportions.save(path)
        write_json(report, fit.report())

    given = None if options.body is None else find_body(options.body)
    settings = {"height": options.height, "body": given and given.offsets.tolist()}
    after = () if given else ("detections.npz", "rig.json")
    body = stages.run("body.json", settings, write, Proportions.load, after)
    return body, read_json(report)


def head_poses(
    stages: Stages, sequence: Recording, search: RigSearch | None, options: MocapOptions,
    on_step: Step,
) -> Path | None:  # fmt: skip
    """File of the head's path: the given one, or head.npz; None where the motion has no world."""

    def write(path: Path) -> None:
        advance = on_step("head pose", len(sequence))
        found = find_head_poses(sequence, sequence.rig, OdometryConfig(self_calibration=False),
                                advance=advance, search=search)  # fmt: skip
        found.save(path)

    if options.head_pose is not None or not options.world:
        return options.head_pose
    try:
        return stages.run("head.npz", {}, write, lambda path: path, ("rig-correction.json",))
    except InputError as error:
        log.warning("%s: the motion is relative to the head", error)
        return None


def track(
    stages: Stages, sequence: Recording, rig: Rig, found: Detections, body: Proportions,
    tracker: TrackerConfig, head_pose: Path | None, on_step: Step,
) -> Track:  # fmt: skip
    """The offline track: track.npz. Raises as `Tracker.track`."""

    def write(path: Path) -> None:
        advance = on_step("track", len(sequence))
        heads = None if head_pose is None else read_head_poses(head_pose, found.times)
        track = track_in_windows(sequence.folder, found, body, tracker, advance, heads, rig)
        config = track.config | {"sequence": sequence.manifest.config_sha256}
        save_track(path, replace(track, config=config))

    heads = None if head_pose is None else sha256(head_pose)
    settings = {"tracker": asdict(tracker), "head_pose": heads}
    after = "detections.npz", "rig.json", "body.json"
    return stages.run("track.npz", settings, write, load_track, after)
