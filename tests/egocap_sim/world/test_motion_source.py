"""The part of a motion that a scene plays."""

from types import SimpleNamespace

import pytest

from egocap.errors import InputError
from egocap_sim.core.rng import make_rng
from egocap_sim.motion.clips import clip_store
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.scene.config import MotionTable, Scene
from egocap_sim.world.motion_source import MotionSource
from egocap_sim.world.world import World


@pytest.mark.parametrize("length_s", [None, 4.5])
def test_a_start_is_in_the_clips_own_time(monkeypatch, length_s):
    """At twice the speed, 9 s after the first second last 4.5 s."""
    clip = make_motion("walk", 10.0, make_rng(1, "motion"))
    stored = SimpleNamespace(clip=clip, raw=clip)
    monkeypatch.setattr(clip_store, "stored_motion", lambda *_, **__: stored)
    table = {"file": "walk.bvh", "start_s": 1.0, "speed": 2.0, "length_s": length_s}
    source = MotionSource(MotionTable.model_validate(table), 30.0, 30, 1)
    assert 133 <= source.available_frames(source.clip()) <= 136


def test_a_start_beyond_the_end_says_what_is_left(monkeypatch):
    clip = make_motion("walk", 10.0, make_rng(1, "motion"))
    monkeypatch.setattr(clip_store, "stored_motion", lambda *_, **__: SimpleNamespace(clip=clip))
    table = MotionTable.model_validate({"file": "walk.bvh", "start_s": 10.5, "speed": 2.0})
    source = MotionSource(table, 30.0, 30, 1)
    with pytest.raises(InputError, match=r"start_s = 10\.5.*less than 9\.9"):
        source.available_frames(source.clip())


def test_more_frames_than_a_motion_has_are_refused():
    motion = {"name": "walk", "length_s": 2.0}
    made = World(Scene.model_validate({"name": "test", "frames": 90, "motion": motion}))
    with pytest.raises(InputError, match=r"90 frames are more than the motion has.*1 to 60"):
        _ = made.trajectory
