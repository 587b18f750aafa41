"""Wrong inputs are what their names say, and a track's doubt in them is compared with the truth."""

from dataclasses import replace

import numpy as np
import pytest

from egocap_eval.studies import doubt
from egocap_eval.studies.doubt import FAULTS, Inputs
from tests.egocap.conftest import make_motion


@pytest.fixture
def given():
    motion = make_motion(frames=4)
    return Inputs(motion.detect("simulated:2"), motion.rig, motion.person)


def made(name, given):
    return FAULTS[name].make(given, np.random.default_rng(0))


def test_cameras_are_rotated_one_alone_each_by_itself_or_all_with_the_head(given):
    before = [mount.T_head_camera for mount in given.rig.mounts]

    def turns(name):
        after = [mount.T_head_camera for mount in made(name, given).rig.mounts]
        relative = [a[:3, :3] @ b[:3, :3].T for a, b in zip(after, before, strict=True)]
        return relative, [np.rad2deg(np.arccos((np.trace(R) - 1) / 2)) for R in relative]

    assert turns("one-20")[1] == pytest.approx([0.0, 20.0], abs=1e-4)
    (first, second), angles = turns("each-5")
    assert angles == pytest.approx([5.0, 5.0]) and not np.allclose(first, second)
    (first, second), angles = turns("pitch-20")
    assert angles == pytest.approx([20.0, 20.0]) and np.allclose(first, second)


def test_stated_confidence_and_named_cause_are_missed_by_themselves():
    sound = {"stated": 0.9, "within": 0.95, "named": 1.0}
    assert doubt._misses("each-5", sound) == []
    (line,) = doubt._misses("each-5", sound | {"within": 0.7})
    assert "each camera rotated by 5 degrees: stated 90 %, within 5 cm 70 %" in line
    (line,) = doubt._misses("each-5", sound | {"named": 0.75})
    assert "named in 75 %" in line


def test_motions_are_tracked_from_sound_and_from_wrong_inputs(monkeypatch, tmp_path):
    monkeypatch.setattr(doubt, "MOTIONS", (("gestures", 512312),))
    monkeypatch.setattr(doubt, "FAULTS", {name: FAULTS[name] for name in ("sound", "exchanged")})
    monkeypatch.setattr(doubt, "clip_seeds", lambda folder, name, clips: {folder / "a.bvh": 3})
    clip = doubt.simulate_motion("idle", frames=20, seed=512320)
    monkeypatch.setattr(doubt, "scenes_of", lambda path, seed, frames: (path,))
    monkeypatch.setattr(doubt, "simulate_scene", lambda path: replace(clip, name=path.stem))
    outcome = doubt.study(motions=tmp_path, frames=20)
    assert outcome.result["motions"] == ["gestures", "a"]
    sound, exchanged = (outcome.result["faults"][name] for name in ("sound", "exchanged"))
    assert sound["within"] > 0.8 and sound["named"] == 1.0 and sound["warning"] is None
    assert exchanged["within"] < 0.3 and "exchanged" in exchanged["warning"]
