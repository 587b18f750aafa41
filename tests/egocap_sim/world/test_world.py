"""What a scene stands for: the same for the same scene and files, wherever they lie."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from egocap.errors import FileError
from egocap_sim.core.resources import builtin_file
from egocap_sim.core.rng import make_rng
from egocap_sim.scene.config import Scene, load_scene
from egocap_sim.scene.scene_error import SceneError
from egocap_sim.world.take import Take
from egocap_sim.world.world import World, build_world


def scene(**tables) -> Scene:
    return Scene.model_validate({"name": "x", "frames": 3, "motion": {"name": "idle"}} | tables)


def write_scene(folder: Path, rig: str = "rig.toml", motion: str = "clip.bvh") -> Scene:
    folder.mkdir(exist_ok=True)
    path = folder / "scene.toml"
    path.write_text(f'name = "x"\n[motion]\nfile = "{motion}"\n[rig]\nfile = "{rig}"\n')
    return load_scene(path)


def test_the_configuration_does_not_depend_on_where_files_lie(tmp_path):
    configs = []
    for folder in (tmp_path / "here", tmp_path / "there"):
        scene_ = write_scene(folder)
        shutil.copy(builtin_file("rig", "egorig2"), folder / "rig.toml")
        (folder / "clip.bvh").write_text("the content, whatever it is, is what counts")
        configs.append(World(scene_).config)
    assert configs[0] == configs[1]
    assert str(tmp_path) not in repr(configs)
    (tmp_path / "there" / "clip.bvh").write_text("other content")
    assert World(scene_).config != configs[1]


def test_a_built_in_rig_is_the_same_by_name_and_by_file():
    named = scene(rig={"name": "egorig2"})
    by_file = scene(rig={"file": str(builtin_file("rig", "egorig2"))})
    assert World(named).config == World(by_file).config
    assert World(scene()).config["rig"] == World(scene(rig={"name": "egorig1"})).config["rig"]


@pytest.mark.parametrize("key", ["file", "joint_names"])
def test_a_missing_file_is_named(tmp_path, key):
    (tmp_path / "clip.bvh").write_text("")
    motion = {"file": str(tmp_path / "clip.bvh")} | {key: str(tmp_path / "none")}
    with pytest.raises(FileError, match="none: cannot be read: No such file"):
        _ = World(scene(motion=motion)).config


def test_the_rig_is_scaled_to_the_size_asked_for():
    rig = World(scene(rig={"size": (320, 256)})).rig
    assert {(c.width, c.height) for c in rig.cameras} == {(320, 256)}


def test_purposes_and_seeds_have_their_own_streams():
    draws = {make_rng(seed, what).random() for seed in (1, 2) for what in ("place", "motion")}
    assert len(draws) == 4 and make_rng(1, "place").random() in draws


def test_a_longer_sequence_begins_like_a_shorter_one():
    short, long = (World(scene(frames=n, motion={"name": "walk"})).motion.clip() for n in (20, 600))
    assert np.array_equal(short.positions, long.positions[: len(short.positions)])


@pytest.mark.parametrize(
    ("tables", "key", "says"),
    [
        ({"motion": {"name": "wlak"}}, "motion", "valid: walk"),
        ({"motion": {"name": "walk", "parameters": {"spede": 1}}}, "motion", "valid: speed"),
        ({"motion": {"name": "walk", "parameters": {"rng": 1}}}, "motion", "valid: speed"),
        ({"motion": {"name": "walk", "start_s": 1e8}}, "motion", "valid: "),
        ({"person": {"outfit": {"top": "cape"}}}, "person", "valid: .*tshirt"),
        ({"person": {"phenotype": {"wings": 0.5}}}, "person", "valid: .*muscle"),
    ],
)
def test_what_cannot_be_made_names_the_table(tables, key, says):
    wrong = scene(**tables)
    with pytest.raises(SceneError, match=f"scene 'x', key '{key}': .*{says}") as caught:
        _ = build_world(wrong).trajectory
    assert caught.value.key == key


def test_an_unknown_place_is_refused_before_it_is_made():
    with pytest.raises(SceneError, match=r"'place\.name': unknown place 'moon' \(valid: room"):
        build_world(scene(place={"name": "moon"}))
    build_world(scene())


def test_a_place_is_as_large_as_the_motion():
    """Furniture and walls keep clear of the wearer's way; a scene's own radius is the least."""

    class Way:
        T_world_body = np.tile(np.eye(4), (3, 21, 1, 1))

    walk = load_scene(builtin_file("scene", "validation-walk"))
    clip = walk.model_copy(update={"motion": type(walk.motion)(file="clip.bvh")})
    for scene in (walk, clip):
        Way.T_world_body[2, 0, 0, 3] = 4.0
        assert World(scene, Take(Way, None)).clear_radius == pytest.approx(4.3)
        Way.T_world_body[2, 0, 0, 3] = 0.5
        assert World(scene, Take(Way, None)).clear_radius == scene.place.clear_radius


def test_a_motion_that_leaves_the_largest_place_is_refused():
    class Way:
        T_world_body = np.tile(np.eye(4), (3, 21, 1, 1))

    Way.T_world_body[2, 0, 1, 3] = -16.0
    with pytest.raises(SceneError, match=r"'motion': .* 16\.0 m .* 'street' \(valid: up to 14\.7"):
        _ = World(scene(place={"name": "street"}), Take(Way, None)).clear_radius
    assert World(scene(place={"name": "chroma"}), Take(Way, None)).clear_radius == 15.0
