"""Scene files: what is written is read back; what is wrong is named."""

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.errors import EgocapError, FileError
from egocap_sim.core.resources import builtin_file, builtin_names, find_file
from egocap_sim.scene.config import Scene, load_scene, to_toml


def write(folder, text):
    path = folder / "scene.toml"
    path.write_text(text)
    return path


GOOD = 'name = "mine"\n[motion]\nname = "walk"\n'


def test_every_built_in_scene_loads_and_is_named_as_its_file():
    assert {"validation-walk", "validation-gesture"} <= set(builtin_names("scene"))
    for name in builtin_names("scene"):
        assert load_scene(builtin_file("scene", name)).name == name


def test_the_papers_recordings_have_the_papers_lengths():
    assert load_scene(builtin_file("scene", "validation-walk")).frames == 250
    assert load_scene(builtin_file("scene", "validation-gesture")).frames == 750


def test_paths_are_relative_to_the_scene_file(tmp_path):
    path = write(tmp_path, 'name = "a"\n[motion]\nfile = "clip.bvh"\n[rig]\nfile = "../r.toml"\n')
    scene = load_scene(path)
    assert Path(scene.motion.file) == tmp_path / "clip.bvh"
    assert Path(scene.rig.file).resolve() == tmp_path.parent / "r.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD + "[rig]\nfield = 1\n", r"key 'rig\.field': unknown key \(valid: .*name"),
        (GOOD + "[person]\nheight_m = 5\n", r"'person\.height_m'.*less than or equal to 2"),
        ("frames = 0\n" + GOOD, r"'frames'.*greater than or equal to 1"),
        ('frames = "many"\n' + GOOD, r"'frames'.*integer"),
        ('name = "a"\n[motion]\n', r"'motion'.*either 'name'"),
        ('name = "a"\n[motion]\nname = "walk"\nfile = "b.bvh"\n', r"'motion'.*either 'name'"),
        ('name = "../up"\n[motion]\nname = "walk"\n', r"'name'.*pattern"),
        ('[motion]\nname = "walk"\n', r"'name'.*required"),
        (GOOD + "[rig]\nsize = [1280]\n", r"'rig\.size"),
        (GOOD + "[sensor]\nfull_well_e = 5\n", r"'sensor\.full_well_e'.*at least 10 electrons"),
        (GOOD + "then_start_s = 1.0\n", r"'motion'.*'then_start_s' requires 'then'"),
        (GOOD + '[place]\nname = "chroma"\ntextures = "t"\n', r"'place'.*'textures' is not for"),
        (GOOD + '[place]\nname = "chroma"\npanorama = "p"\n', r"'place'.*'panorama' is not for"),
        (
            GOOD + 'parameters = {speed = 1.0}\n[episodes]\nmotions = ["idle"]\n',
            r"'parameters' of \[motion\] is unused with 'motions' of \[episodes\]",
        ),
        (GOOD + "start_s = 1.0\n[episodes]\n", r"'start_s' of \[motion\] is drawn in \[episodes\]"),
        ("name = mine\n", "TOML.*line 1"),
    ],
)
def test_a_wrong_scene_names_file_key_and_what_is_valid(tmp_path, text, message):
    with pytest.raises(FileError, match=r"scene\.toml") as caught:
        load_scene(write(tmp_path, text))
    assert re.search(message, str(caught.value)), caught.value


def test_unknown_built_ins_list_the_known():
    with pytest.raises(EgocapError, match=r"valid: .*validation-walk"):
        find_file("scene", "validation-wlak")


texts = st.text(st.characters(blacklist_categories=("Cs",)), max_size=12)


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**62), frames=st.integers(1, 10**6), motion=texts,
    parameters=st.dictionaries(texts, st.one_of(st.booleans(), st.integers(-9, 9), texts,
                                                st.floats(allow_nan=False, allow_infinity=False))),
)  # fmt: skip
def test_scenes_survive_being_written(seed, frames, motion, parameters):
    scene = Scene.model_validate({
        "name": "x", "seed": seed, "frames": frames,
        "motion": {"name": motion, "parameters": parameters},
    })  # fmt: skip
    assert Scene.model_validate(tomllib.loads(to_toml(scene))) == scene


@settings(deadline=None, max_examples=200)
@given(cut=st.integers(0, 400), at=st.integers(0, 400), byte=st.integers(0, 255))
def test_a_mangled_scene_gives_an_error_or_a_scene(tmp_path_factory, cut, at, byte):
    data = bytearray(builtin_file("scene", "validation-walk").read_bytes())
    data[at % len(data)] = byte
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_bytes(data[: len(data) - cut % len(data)])
    try:
        assert isinstance(load_scene(path), Scene)
    except FileError as error:
        assert "scene.toml" in str(error)
