"""One small sequence for the whole session: generated once, read by many tests, changed by none."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from egocap.errors import MachineError
from egocap_sim.core.resources import builtin_file
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene


@pytest.fixture(scope="session")
def tiny_scene() -> Scene:
    """The first 7 frames of validation-walk at 160 x 128, in shards of 2, with depth."""
    scene = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    scene["frames"], scene["rig"]["size"] = 7, (160, 128)
    scene["record"] |= {"shard_frames": 2, "depth": True}
    return Scene.model_validate(scene)


@pytest.fixture(scope="session")
def tiny_sequence(tiny_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of its sequence; copy it before changing anything."""
    folder = tmp_path_factory.mktemp("tiny") / "sequence"
    try:
        generate(tiny_scene, folder, workers=1)
    except MachineError as error:
        warnings.warn(f"NO TEST OF SEQUENCES RUNS HERE: {error}", stacklevel=1)
        pytest.skip(f"no OpenGL: {error}")
    return folder
