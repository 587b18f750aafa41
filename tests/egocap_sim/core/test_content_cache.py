"""What is kept is what was made, bit by bit, and nothing else is believed."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.assets.mesh import Actor
from egocap_sim.core import content_cache
from egocap_sim.core.content_cache import kept
from egocap_sim.environment.place import Place
from egocap_sim.scene.config import Scene
from egocap_sim.world.world import World, build_world


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kept things."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "egocap" / "made"


def never() -> np.ndarray:
    raise AssertionError("made again")


def test_made_once_for_the_same_values(folder):
    made = np.asfortranarray(np.random.default_rng(0).normal(size=(3, 4)))
    first = kept("thing", {"seed": 1}, lambda: made)
    again = kept("thing", {"seed": 1}, never)
    for found in (first, again):
        assert found.tobytes() == made.tobytes() and found.flags.f_contiguous
    for kind, values in (("thing", {"seed": 2}), ("other", {"seed": 1})):
        with pytest.raises(AssertionError, match="made again"):
            kept(kind, values, never)
    assert len(list(folder.iterdir())) == 1


def test_other_code_makes_it_again(monkeypatch):
    kept("thing", {}, lambda: np.ones(2))
    monkeypatch.setattr(content_cache, "_maker", lambda: ["other code"])
    with pytest.raises(AssertionError, match="made again"):
        kept("thing", {}, never)


def test_errors_are_raised_and_not_kept(folder):
    def fail() -> None:
        raise InputError("no such hat")

    with pytest.raises(InputError, match="no such hat"):
        kept("thing", {}, fail)
    assert not folder.exists()


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty"])
def test_damaged_file_is_made_again(folder, caplog, damage):
    kept("thing", {}, lambda: np.ones(20))
    (path,) = folder.iterdir()
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes({"cut": content[:-9], "flipped": content, "empty": b""}[damage])
    assert kept("thing", {}, lambda: np.full(20, 2.0))[0] == 2.0
    assert "damaged" in caplog.text
    assert kept("thing", {}, never)[0] == 2.0


class _Hostile:
    def __reduce__(self):
        return os.mkdir, ("hostile",)


@pytest.mark.parametrize("within", [_Hostile(), content_cache.kept, Path()])
def test_other_classes_and_functions_are_refused(within, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(pickle.UnpicklingError):
        content_cache._load(pickle.dumps(Actor("a", (within,)), protocol=5))  # pyright: ignore[reportArgumentType]
    assert not Path("hostile").exists()


def test_longest_unused_are_removed(folder, monkeypatch):
    monkeypatch.setattr(content_cache, "MOST_BYTES", 5000)
    for seed in range(4):
        kept("thing", {"seed": seed}, lambda: np.zeros(200))  # 1600 bytes and a header
        for age, path in enumerate(sorted(folder.iterdir(), key=lambda p: -p.stat().st_mtime_ns)):
            os.utime(path, (1e9 - age, 1e9 - age))
        kept("thing", {"seed": 0}, never)  # used just now
    assert len(list(folder.iterdir())) == 2
    kept("thing", {"seed": 3}, never)


def test_unwritable_cache_only_takes_time(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    for value in (1.0, 2.0):
        assert kept("thing", {}, lambda value=value: np.full(2, value))[0] == value


def test_wearer_and_place_are_as_made(tiny_scene: Scene, folder):
    made = World(tiny_scene)
    for _ in range(2):
        world = build_world(tiny_scene)
        assert _bits(world.place) == _bits(made.place)
        assert _bits(world.person.actor) == _bits(made.person.actor)
        for name in ("joints", "body_vertices", "body_owner"):
            assert np.array_equal(getattr(world.person, name), getattr(made.person, name))
        assert world.person.description == made.person.description
    assert len(list(folder.iterdir())) == 2


def test_places_of_images_are_not_kept(tiny_scene: Scene, folder, monkeypatch):
    from egocap_sim.world import world

    monkeypatch.setattr(world, "build_place", lambda *_: "made of images")
    table = tiny_scene.place.model_copy(update={"textures": "folder"})
    assert World(tiny_scene.model_copy(update={"place": table}), cached=True).place == (
        "made of images"
    )
    assert not folder.exists()


def test_worlds_of_episodes_are_not_kept(tiny_scene: Scene, folder):
    content = tiny_scene.model_dump() | {"episodes": {}}
    _ = build_world(Scene.model_validate(content)).place
    assert not folder.exists()


def _bits(thing: Actor | Place) -> list[object]:
    """Every array of its meshes, with type and memory layout, and the rest as text."""
    found: list[object] = []
    for mesh in thing.meshes:
        for name, value in sorted(vars(mesh).items()):
            array = isinstance(value, np.ndarray)
            found.append((name, value.dtype, value.tobytes("A")) if array else (name, str(value)))
    return found
