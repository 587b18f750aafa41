"""Changes of a scene by options: what they replace, and what they refuse."""

import pytest

from egocap.errors import FileError, InputError
from egocap_sim.core.resources import builtin_file, rig_file
from egocap_sim.scene.config import Scene, load_scene
from egocap_sim.world.overrides import Overrides, override_scene


def scene(**tables) -> Scene:
    return Scene.model_validate({"name": "test", "motion": {"name": "walk"}} | tables)


def test_a_motion_replaces_those_of_episodes():
    episodes = {"motions": ["walk", "idle"], "clips": "somewhere", "clip_share": 1.0}
    changed = override_scene(scene(episodes=episodes), Overrides(motion="juggle"))
    assert changed.motion.name == "juggle" and changed.episodes is not None
    assert changed.episodes.motions == () and changed.episodes.clips is None


def test_a_start_is_refused_where_episodes_draw_it():
    with pytest.raises(InputError, match="--start in a scene with episodes"):
        override_scene(scene(episodes={}), Overrides(start=2.0))
    one = override_scene(scene(episodes={}), Overrides(start=2.0, no_episodes=True))
    assert one.motion.start_s == 2.0


def test_a_file_beside_the_motions_of_episodes_is_refused():
    with pytest.raises(ValueError, match=r"'file' of \[motion\] is unused with 'motions'"):
        scene(motion={"file": "clip.bvh"}, episodes={"motions": ["walk"]})


def test_a_rig_replaces_a_sampled_family():
    sampled = scene(rig={"name": "sampled", "family": "glasses", "size": [320, 256]})
    changed = override_scene(sampled, Overrides(rig="egorig2"))
    assert changed.rig.name == "egorig2" and changed.rig.family is None
    assert changed.rig.size == (320, 256)


def test_the_rate_is_the_rigs_where_the_scene_has_none(tmp_path):
    rig = rig_file("ego4view").read_text()
    (tmp_path / "rig.toml").write_text(rig.replace("frame_rate = 25.0", "frame_rate = 50.0"))
    changes = Overrides(rig=str(tmp_path / "rig.toml"))
    assert override_scene(scene(), changes).fps == 50.0
    assert override_scene(scene(fps=25.0), changes).fps == 25.0
    (tmp_path / "rig.toml").write_text(rig.replace("frame_rate = 25.0", "frame_rate = 500.0"))
    with pytest.raises(FileError, match=r"frame_rate of the rig.*fps"):
        override_scene(scene(), changes)
    walk = load_scene(builtin_file("scene", "validation-walk"))
    assert override_scene(walk, Overrides()) == walk
