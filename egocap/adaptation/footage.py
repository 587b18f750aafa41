"""Footage to adapt to: tracked recordings, cut into stretches of labelled canonical views.

Every fifth stretch is held out, without the frames beside its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.adaptation.config import AdaptOptions
from egocap.adaptation.labels import Labels, at_picture_times, tracked_labels
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.data.detections import Detections, load_detections
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.track import Track, load_track
from egocap.detect.canonical_view import CanonicalView
from egocap.detect.detector import Detector
from egocap.detect.input_images import recorded_pictures
from egocap.detect.train.examples import HIDDEN, Views, ViewStore, canonical_labels
from egocap.errors import InputError
from egocap.files import make_folder
from egocap.footage.sources import Step
from egocap.motion_capture import steps
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.stages import Stages
from egocap.pose.config import TrackerConfig
from egocap.track.consistency import warning_of

STRETCH_S, GAP_S = 4.0, 0.3
FEWEST = 10  # stretches
_HELD_OUT = 5  # one in so many


@dataclass(frozen=True, eq=False)
class Recording:
    """A sequence with its detections, its track and the labels made from them."""

    sequence: Sequence
    labels: Labels


def check_footage(folder: Path) -> None:
    """Raise FileError or InputError for footage of which `track_footage` makes no use later.

    The pictures are not read.
    """
    sequence = _read(folder).sequence if _is_tracked(folder) else open_sequence(folder)
    _ = sequence.rig  # read when it is first used
    stretches(sequence.times)


def track_footage(folder: Path, work: Path, options: AdaptOptions, on_step: Step) -> Recording:
    """Detections, track and labels of a sequence, made in `work`; or those of a folder of `mocap`.

    Raises FileError, InputError as `Tracker`, and for a track that a wrong rig or body biases: the
    detector would learn the bias.
    """
    if _is_tracked(folder):
        return _read(folder)
    sequence = open_sequence(folder)
    make_folder(work)
    stages = Stages(work)
    wearer = MocapOptions(height=options.height, body=options.body, weights=options.weights)
    found = steps.detections(stages, sequence, wearer, on_step)
    rig, _ = steps.rig(stages, sequence, wearer, on_step)
    body, _ = steps.body(stages, rig, found, wearer, on_step)
    track = steps.track(stages, sequence, rig, found, body, TrackerConfig(), None, on_step)
    return Recording(sequence, _labels(sequence, rig, found, track))


def _is_tracked(folder: Path) -> bool:
    """Whether it is a folder of `mocap`."""
    return (folder / "sequence").is_dir()


def _read(folder: Path) -> Recording:
    """The recording of a folder of `mocap`."""
    sequence = open_sequence(folder / "sequence")
    found = load_detections(folder / "detections.npz")
    corrected = folder / "rig.json"
    rig = load_rig(corrected) if corrected.exists() else sequence.rig
    return Recording(sequence, _labels(sequence, rig, found, load_track(folder / "track.npz")))


def _labels(sequence: Sequence, rig: Rig, found: Detections, track: Track) -> Labels:
    if (wrong := warning_of(track, "geometry")) is not None:
        raise InputError(f"{sequence.folder.name}: {wrong}", valid="footage of a rig that is "
                         "calibrated as it is, and --height or --body of its wearer")  # fmt: skip
    labels = tracked_labels(track, found, rig)
    if sequence.frame_times is None:
        return labels
    return at_picture_times(labels, track, rig, sequence.frame_times)


def labelled_views(
    recordings: list[Recording], detectors: list[Detector], most: int, on_step: Step
) -> tuple[ViewStore, ViewStore]:
    """Views to train on, and those held out, a sequence of views for every stretch.

    Args:
        recordings: with labels.
        detectors: one for the rig of each recording.
        most: largest number of images, of all recordings together.
        on_step: called at the beginning.

    Raises:
        InputError: footage shorter than 10 s, or no labels.
    """
    frames = sum(len(r.sequence) * len(r.sequence.rig.mounts) for r in recordings)
    every = max(1, -(-frames // most))
    advance = on_step("read", sum(len(r.sequence) for r in recordings) // every)
    kept: list[Views] = []
    held_out: list[Views] = []
    for recording, detector in zip(recordings, detectors, strict=True):
        for index, rows in enumerate(stretches(recording.sequence.times)):
            views = _views(recording, rows[::every], detector)
            advance(len(rows[::every]))
            if len(views):
                (held_out if index % _HELD_OUT == _HELD_OUT // 2 else kept).append(views)
    if not kept or len(held_out) < 2:
        raise InputError(
            "no image has a joint of which the tracker is sure",
            valid="footage that `egocap mocap` tracks; its page says what is wrong",
        )
    return ViewStore(tuple(kept)), ViewStore(tuple(held_out))


def stretches(times: Float[Array, "T"]) -> list[range]:
    """Frames of the stretches in order; between two of them `GAP_S` are left out.

    Raises InputError where the footage is shorter than `FEWEST` stretches of a second.
    """
    seconds = float(times[-1] - times[0])
    if seconds < FEWEST:
        raise InputError(f"footage of {seconds:.1f} s", valid=f"{FEWEST} s or more")
    count = max(FEWEST, round(seconds / STRETCH_S))
    edges = times[0] + seconds * np.arange(count + 1) / count
    first = np.searchsorted(times, edges[:-1] + 0.5 * GAP_S)
    last = np.searchsorted(times, edges[1:] - 0.5 * GAP_S)
    return [range(int(a), int(b)) for a, b in zip(first, last, strict=True)]


def _views(recording: Recording, rows: range, detector: Detector) -> Views:
    """Views of some frames that show a labelled joint."""
    sequence, labels = recording.sequence, recording.labels
    spec = detector.weights.view
    canonical = [CanonicalView(mount, spec) for mount in sequence.rig.mounts]
    images: list[Array] = []
    columns: list[tuple[Array, Array, Array]] = []
    for i in rows:
        found, slots = detector.canonical([recorded_pictures(sequence, i)])
        for image, v in zip(found, slots[:, 1], strict=True):
            width = sequence.rig.cameras[v].width
            label = canonical_labels(labels.points[i, v], labels.state[i, v], canonical[v], width)
            if (label[1] <= HIDDEN).any():
                images.append(image)
                columns.append(label)
    if not images:
        empty = np.zeros((0, spec.height, spec.width, 3), np.uint8)
        return Views(empty, None, np.zeros((0, 18, 2)), np.zeros((0, 18), np.uint8),
                     np.zeros((0, 18)))  # fmt: skip
    points, state, scale = (np.stack(c) for c in zip(*columns, strict=True))
    return Views(np.stack(images), None, points, state.astype(np.uint8), scale)
