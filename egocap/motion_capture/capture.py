"""Motion capture in one call: footage and a rig file in; track, BVH, film and page out.

Stages: sequence (import), detections.npz, rig-correction.json and rig.json, body.json, head.npz,
track.npz, motion.bvh, film.mp4, index.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from egocap.cameras.rig import Rig
from egocap.data.bvh import write_bvh
from egocap.data.head_pose import load_head_pose, load_surroundings, read_head_poses
from egocap.data.manifest import MANIFEST
from egocap.data.resampling import evenly
from egocap.data.sequence import Sequence as Recording
from egocap.data.track import Track
from egocap.detect.engine import open_engine
from egocap.detect.weights import open_weights
from egocap.errors import InputError
from egocap.files import make_folder, read_npz, write_json
from egocap.fitting.wearer import average_body, find_body
from egocap.footage.config import ImportOptions
from egocap.footage.importing import import_footage
from egocap.footage.sources import Step
from egocap.motion_capture import steps
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.findings import Findings, find
from egocap.motion_capture.page import write_page
from egocap.motion_capture.stages import Stages
from egocap.pose.config import TrackerConfig
from egocap.schema import parsed
from egocap.track.view_agreement import check_agreement
from egocap.view.film import write_film

FILM, PAGE = "film.mp4", "index.html"


@dataclass(frozen=True, eq=False)
class Capture:
    """Results of a run, and the folder that holds their files."""

    folder: Path
    sequence: Recording
    track: Track
    findings: Findings

    def __repr__(self) -> str:
        return f"Capture('{self.folder}', {self.track})"


def mocap(
    sources: Sequence[str | Path],
    rig: Rig | str | Path,
    out: str | Path,
    options: MocapOptions = MocapOptions(),  # noqa: B008 (frozen)
    footage: ImportOptions = ImportOptions(),  # noqa: B008 (frozen)
    tracker: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
    on_step: Step = lambda name, total: lambda count: None,
) -> Capture:
    """Capture the motion of the wearer of a rig from footage of its cameras.

    The same call goes on where an interrupted one stopped, and runs no stage again whose settings
    and input are the same.

    Args:
        sources: a video or a folder of pictures for every view, in the order of the rig.
        rig: the cameras, or their file.
        out: folder of the results.
        options: what is known of the wearer, and what to write.
        footage: how the footage is read.
        tracker: settings of the tracker.
        on_step: called at the beginning of every step.

    Raises:
        FileError: a file is missing, damaged, or of another shape than the rig's.
        InputError: no common time, no detections, or views that look exchanged.
    """
    if options.body is not None and options.height is not None:
        raise InputError("--height and --body", valid="one of them")
    _refuse_early(options)
    folder = Path(out)
    make_folder(folder)
    if (folder / MANIFEST).exists():
        raise InputError(f"{folder} is itself a sequence", valid="another folder, for the results")
    sequence = import_footage(sources, rig, folder / "sequence", footage, on_step)
    if options.head_pose is not None:
        _ = read_head_poses(options.head_pose, sequence.times)  # or refuse now
    stages = Stages(folder)
    found = steps.detections(stages, sequence, options, on_step)
    agreement = check_agreement(found, sequence.rig)
    if agreement.looks_exchanged and not options.accept_swapped:
        raise InputError(
            "the views look exchanged: rays to the same joint miss each other by "
            f"{agreement.as_given:.1f} degrees; by {agreement.exchanged:.1f} in the other order",
            valid="the files in the order of the rig, or --accept-swapped",
        )
    rig, search = steps.rig(stages, sequence, options, on_step)
    body, bones = steps.body(stages, rig, found, options, on_step)
    heads = steps.head_poses(stages, sequence, search, options, on_step)
    track = steps.track(stages, sequence, rig, found, body, tracker, heads, on_step)
    assert sequence.footage is not None
    findings = find(track, found, rig, sequence.footage, agreement, options.height,
                    _vertical(heads))  # fmt: skip
    _results(stages, sequence, track, findings, bones, heads, options, on_step)
    return Capture(folder, sequence, track, findings)


def _refuse_early(options: MocapOptions) -> None:
    """Raise FileError or InputError now for what a later stage would refuse."""
    _ = find_body(options.body) if options.body else average_body(options.height)
    if options.weights is not None:
        open_engine(open_weights(options.weights))
    if options.head_pose is not None:
        load_head_pose(options.head_pose)
        load_surroundings(options.head_pose)


def _vertical(heads: Path | None) -> dict[str, Any] | None:
    """How sure up and the floor are, where the file of the head's path says so."""
    if heads is None:
        return None
    facts = read_npz(heads, only=("facts",)).get("facts")
    return None if facts is None else parsed(str(facts), heads, key="facts").get("vertical")


def _results(
    stages: Stages, sequence: Recording, track: Track, findings: Findings, bones: dict[str, Any],
    heads: Path | None, options: MocapOptions, on_step: Step,
) -> None:  # fmt: skip
    def film(path: Path) -> None:
        points = None if heads is None else load_surroundings(heads)
        write_film(path, sequence, track, on_step("film", len(sequence)), points)

    after = ("track.npz",)
    stages.run("motion.bvh", {}, lambda path: write_bvh(path, evenly(track)), lambda path: path,
               after)  # fmt: skip
    if not options.skip_film:
        stages.run(FILM, {}, film, lambda path: path, after)
    write_json(stages.folder / "findings.json", findings.to_dict())
    write_page(stages.folder / PAGE, sequence, track, findings, bones,
               None if options.skip_film else FILM)  # fmt: skip
