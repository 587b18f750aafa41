"""The simulator called from Python."""

from pathlib import Path

import numpy as np
import pytest

import egocap_sim
from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap_sim.api import scene_file
from egocap_sim.scene.config import Scene
from egocap_sim.world.overrides import Overrides

SMALL = {"size": (160, 128), "frames": 2}


def test_generate_opens_the_sequence_that_it_makes(tmp_path, tiny_sequence):
    made = egocap_sim.generate("validation-walk", tmp_path / "s", **SMALL)
    assert isinstance(made, Sequence) and len(made) == 2 and made.rig.cameras[0].width == 160
    for mine, other in zip(made, Sequence(tiny_sequence), strict=False):
        assert np.array_equal(mine.images, other.images)
    assert egocap_sim.verify(made.folder).clean
    egocap_sim.preview(made, tmp_path / "sheet.png", rows=2, width=64)
    assert (tmp_path / "sheet.png").stat().st_size > 1000


def test_a_scene_of_episodes_is_generated_as_episodes_or_as_one_sequence(tmp_path):
    scene = Scene.model_validate({
        "name": "short", "frames": 3, "rig": {"size": (96, 80)}, "motion": {"name": "idle"},
        "place": {"name": "chroma"}, "episodes": {"frames": (1, 2)},
    })  # fmt: skip
    with pytest.raises(InputError, match="generate_episodes"):
        egocap_sim.generate(scene, tmp_path / "none")
    one = egocap_sim.generate(scene, tmp_path / "one", overrides=Overrides(no_episodes=True))
    assert len(one) == 3
    episodes = egocap_sim.generate_episodes(scene, tmp_path / "episodes")
    assert len(episodes) > 1 and sum(map(len, episodes)) == 3


def test_a_value_given_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match="--masks and --no-masks"):
        overrides = Overrides(masks=True, no_masks=True)
        egocap_sim.generate("validation-walk", tmp_path / "s", overrides=overrides)


def test_a_folder_does_not_hide_a_built_in_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("walk").mkdir()  # as the recording of that scene
    Path("stairs").write_text("")
    assert scene_file("walk").name == "walk.toml"
    assert scene_file("stairs") == Path("stairs")
    assert scene_file("mine/walk.toml") == Path("mine/walk.toml")
