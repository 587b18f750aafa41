"""The rendered part of the regression guard: a short clip, its truth against its pixels."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

import numpy as np

from egocap.data.sequence import VISIBLE, Sequence
from egocap.errors import EgocapError
from egocap.evaluation import evaluate_detections
from egocap_eval.harness.check import Number
from egocap_sim.core.resources import builtin_file
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene
from egocap_sim.verification.crosscheck import check_pixels

log = logging.getLogger(__name__)

SEED, FRAMES, SIZE = 400904, 8, (320, 256)


def rendered_numbers() -> dict[str, Number]:
    """Render the clip and measure what its pictures, labels and depths say of its truth.

    Raises MachineError where there is no OpenGL.
    """
    with tempfile.TemporaryDirectory() as folder:
        generate(_scene(), Path(folder) / "clip", workers=1)
        sequence = Sequence(Path(folder) / "clip")
        pixels = check_pixels(sequence)
        visible = 100 * float((sequence.truth.visibility == VISIBLE).mean())
        light = np.mean([[image.mean() for image in frame.images] for frame in sequence])
        contrast = np.mean([[image.std() for image in frame.images] for frame in sequence])
        detector = _detector_numbers(sequence)
    return detector | {
        "rendered/labelled": Number(100 * pixels.labelled_share, 1.0, "higher", "%"),
        "rendered/in_depth": Number(100 * pixels.depth_share, 1.0, "higher", "%"),
        "rendered/visible": Number(visible, 1.0, "equal", "%"),
        "rendered/light": Number(float(light), 1.0, "equal", "of 255"),
        "rendered/contrast": Number(float(contrast), 1.0, "equal", "of 255"),
    }


def _detector_numbers(sequence: Sequence) -> dict[str, Number]:
    """Of the detector that is shipped, on the clip; none where there is none."""
    from egocap.detect.detector import Detector, detect
    from egocap.detect.weights import open_weights

    try:
        weights = open_weights()
    except EgocapError as error:
        log.info("the detector is left out: %s", error)
        return {}
    found = detect(sequence, Detector(sequence.rig, weights, "onnxruntime"))  # alike everywhere
    truth = sequence.truth
    seen = truth.visibility == VISIBLE
    widths = np.array([mount.camera.width for mount in sequence.rig.mounts], float)
    score = evaluate_detections(
        found.points, found.valid, truth.joints_2d, truth.in_view, seen, widths
    )
    values = {"pck20": score.pck20_seen, "auc20": score.auc20_seen}
    return {
        f"detector/{name}": Number(value, 1.0, "higher", "%")
        for name, value in values.items()
        if value is not None
    }


def _scene() -> Scene:
    scene = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    scene |= {"name": "check", "frames": FRAMES, "seed": SEED}
    scene["rig"]["size"] = SIZE
    scene["record"] |= {"depth": True, "masks": True, "shard_frames": FRAMES}
    return Scene.model_validate(scene)
