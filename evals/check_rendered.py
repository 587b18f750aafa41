"""The rendered part of the regression guard: a short clip, its truth against its pixels."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from egocap.sequence import VISIBLE, Sequence
from egocap_sim.builtin import builtin_file
from egocap_sim.crosscheck import check_pixels
from egocap_sim.record import generate
from egocap_sim.scene import Scene, load_scene
from evals.check import Number

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
    return {
        "rendered/labelled": Number(100 * pixels.labelled_share, 1.0, "higher", "%"),
        "rendered/in_depth": Number(100 * pixels.depth_share, 1.0, "higher", "%"),
        "rendered/visible": Number(visible, 1.0, "equal", "%"),
        "rendered/light": Number(float(light), 1.0, "equal", "of 255"),
        "rendered/contrast": Number(float(contrast), 1.0, "equal", "of 255"),
    }


def _scene() -> Scene:
    scene = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    scene |= {"name": "check", "frames": FRAMES, "seed": SEED}
    scene["rig"]["size"] = SIZE
    scene["record"] |= {"depth": True, "masks": True, "shard_frames": FRAMES}
    return Scene.model_validate(scene)
