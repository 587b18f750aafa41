"""Scenes with bystanders and props: the same bytes for any number of workers."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.data.truth import OCCLUDED
from egocap.errors import InputError
from egocap_sim.core.part_labels import OBJECT, OTHER_PERSON
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene, to_toml
from egocap_sim.verification.integrity import verify


def scene(**changes) -> Scene:
    tables = {
        "name": "play",
        "frames": 6,
        "seed": 8,
        "rig": {"size": (160, 128)},
        "motion": {"name": "dribble"},
        "place": {"name": "studio", "clear_radius": 3.0},
        "things": [{"kind": "ball"}],
        "others": {"count": 2, "farthest_m": 1.6},
        "record": {"shard_frames": 2},
    }
    return Scene.model_validate(tables | changes)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("extras") / "one"
    generate(scene(), folder, workers=0)
    return folder


def checksums(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()}


def test_two_workers_write_the_same_bytes(folder, tmp_path):
    assert verify(folder).clean
    generate(scene(), tmp_path / "two", workers=2)
    assert checksums(tmp_path / "two") == checksums(folder)


def test_bystanders_and_props_are_drawn_and_occlude_joints(folder):
    sequence = Sequence(folder)
    labels = {
        part: np.mean([(sequence.mask(t, view) == part).mean() for t in range(len(sequence))])
        for part in (OBJECT, OTHER_PERSON)
        for view in sequence.manifest.views
    }
    assert labels[OBJECT] > 0.001 and labels[OTHER_PERSON] > 0.005
    assert (sequence.truth.visibility == OCCLUDED).any()  # the ball before a foot or hand


def test_scene_file_round_trip(tmp_path):
    (tmp_path / "scene.toml").write_text(to_toml(scene()))
    assert load_scene(tmp_path / "scene.toml") == scene()


def test_prop_with_unsuitable_motion_raises_before_writing(tmp_path):
    wrong = scene(motion={"name": "walk"})
    with pytest.raises(InputError, match=r"things\.0.*needs the motion 'dribble'"):
        generate(wrong, tmp_path / "none")
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("episodes, drawn", [
    ({"motions": ["dribble", "walk"]}, "'walk'"), ({"clips": "clips"}, "a motion file"),
])  # fmt: skip
def test_prop_that_an_episode_cannot_use_raises_before_writing(tmp_path, episodes, drawn):
    with pytest.raises(InputError, match=rf"things\.0.*needs the motion 'dribble', not {drawn}"):
        generate(scene(episodes=episodes), tmp_path / "none")
    assert not (tmp_path / "none").exists()
