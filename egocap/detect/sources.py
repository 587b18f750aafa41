"""Detections of a sequence by the name of their source: a file, the network, or simulation.

No other module of the tracking pipeline reads the truth of a sequence; it is passed to the
synthetic detector only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from egocap.errors import InputError

if TYPE_CHECKING:
    from egocap.cameras.rig import Rig
    from egocap.data.detections import Detections
    from egocap.data.sequence import Sequence


def detections_from(
    sequence: Sequence, source: str, seed: int, rig: Rig | None = None
) -> Detections:
    """Detections of a sequence: `simulated:...`, `learned[:FILE]`, or the name of an npz file.

    Args:
        sequence: what to detect in.
        source: `egocap.detect.synthetic.FORM`, `learned` with an optional file of weights, or a
            file of detections.
        seed: of simulated noise.
        rig: cameras for the network in place of the sequence's own.

    Raises:
        InputError: an unknown source, or a negative seed.
        FileError: a missing or damaged file, or one made from other frames than the sequence's.
    """
    from egocap.data.detections import load_detections
    from egocap.data.input_checks import require_same_times
    from egocap.detect.synthetic import FORM

    kind, _, rest = source.partition(":")
    if source.endswith(".npz"):
        found = load_detections(source)
        require_same_times(found.times, sequence.times, source)
        return found
    if kind == "learned":
        return _learned(sequence, rest, rig)
    if kind == "simulated":
        return _simulated(sequence, source, seed)
    valid = f"{FORM}; learned[:FILE]; a file of detections, .npz"
    raise InputError(f"unknown source of detections '{source}'", valid=valid)


def synthetic_detections(
    sequence: Sequence, sigma: float = 2.0, seed: int = 0, *, options: str = ""
) -> Detections:
    """Detections drawn around the true joints of a simulated sequence.

    They stand in for a detector of known error. Requires a sequence with truth.

    Args:
        sequence: a simulated sequence.
        sigma: standard deviation of the error along each image axis, pixels at 640 x 512.
        seed: of the noise.
        options: further errors, as in `egocap.detect.synthetic.FORM`: "outliers=0.1,tails=3".

    Raises:
        InputError: a value out of its range, or an unknown option.
    """
    return _simulated(sequence, f"simulated:{sigma}" + (f",{options}" if options else ""), seed)


def _simulated(sequence: Sequence, source: str, seed: int) -> Detections:
    import numpy as np

    from egocap.data.truth import VISIBLE
    from egocap.detect.synthetic import ProjectedJoints, simulate_detections

    if seed < 0:
        raise InputError(f"seed {seed}", valid="0 or more")
    truth = sequence.truth
    joints = ProjectedJoints(
        truth.joints_2d, truth.visibility == VISIBLE, truth.in_view, truth.time,
        np.array([(camera.width, camera.height) for camera in sequence.rig.cameras]),
    )  # fmt: skip
    return simulate_detections(joints, source, np.random.default_rng(seed))


def _learned(sequence: Sequence, weights: str, rig: Rig | None) -> Detections:
    from egocap.commandline import progress
    from egocap.detect.detector import Detector

    detector = Detector(rig or sequence.rig, weights or None)
    with progress("detect", len(sequence)) as advance:
        return detector.detect(sequence, on_frames=advance)
