"""Detections of a sequence, by the name of where they come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from egocap.errors import InputError

if TYPE_CHECKING:
    from egocap.data.detections import Detections
    from egocap.data.sequence import Sequence


def detections_from(sequence: Sequence, source: str, seed: int) -> Detections:
    """Detections of a sequence by the name of their source, or from a file; `seed` is of noise.

    Raises InputError or FileError, also for a file made from other frames than the sequence's.
    """
    import numpy as np

    from egocap.data.detections import load_detections
    from egocap.data.input_checks import require_same_times
    from egocap.data.sequence import VISIBLE
    from egocap.detect.synthetic import FORM, parse_source, simulate_detections

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


def _learned(sequence: Sequence, weights: str) -> Detections:
    from egocap.commandline import progress
    from egocap.detect.detector import Detector, detect
    from egocap.detect.weights import open_weights

    detector = Detector(sequence.rig, open_weights(weights or None))
    with progress("detect", len(sequence)) as advance:
        return detect(sequence, detector, on_frames=advance)
