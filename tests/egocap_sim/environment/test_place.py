"""Places: free where people move, right way round, and the same for the same seed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from egocap.errors import FileError, InputError
from egocap_sim.assets import furniture, textures
from egocap_sim.assets.mesh import Material
from egocap_sim.assets.primitives import ball, box, cylinder, sheet
from egocap_sim.core import part_labels
from egocap_sim.environment.place import at_dusk
from egocap_sim.environment.places import PLACES, make_place
from egocap_sim.environment.texture_folder import picture_files, read_picture, with_pictures


@pytest.mark.parametrize("name", PLACES)
def test_the_same_generator_gives_the_same_place(name):
    one, two = (make_place(name, np.random.default_rng(5)) for _ in range(2))
    assert [m.name for m in one.meshes] == [m.name for m in two.meshes]
    for a, b in zip(one.meshes, two.meshes, strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.texture, b.texture)
    np.testing.assert_array_equal(one.light.direction, two.light.direction)


@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("radius", [1.0, 2.5])
def test_free_circle_is_empty(name, radius):
    for seed in range(2):
        place = make_place(name, np.random.default_rng(seed), radius)
        for m in place.meshes:
            on_the_floor, overhead = m.vertices[:, 2].max() < 0.02, m.vertices[:, 2].min() > 2.2
            if not on_the_floor and not overhead and m.name != "sky":
                x, y = m.vertices[m.faces].mean(axis=1)[:, :2].T
                assert np.hypot(x, y).min() >= radius - 1e-6, m.name


@pytest.mark.parametrize("name", PLACES)
def test_meshes_are_valid_and_light_comes_from_above(name):
    place = make_place(name, np.random.default_rng(1))
    for m in place.meshes:
        assert m.faces.min() >= 0 and m.faces.max() < len(m.vertices), m.name
        assert len(m.uv) == len(m.vertices) == len(m.parts), m.name
        assert np.isfinite(m.vertices).all() and np.isfinite(m.uv).all(), m.name
        assert m.texture.dtype == np.uint8 and m.texture.ndim == 3, m.name
    assert np.linalg.norm(place.light.direction) == pytest.approx(1.0)
    assert place.light.direction[2] < -0.4


@pytest.fixture(scope="module")
def rooms():
    return [make_place("room", np.random.default_rng(seed)) for seed in range(4)]


def test_walls_floor_and_ceiling_face_the_room(rooms):
    for place in rooms:
        for m in place.meshes:
            if m.name in ("wall", "floor", "ceiling", "window", "picture"):
                a, b, c = (m.vertices[m.faces[0, i]] for i in range(3))
                inward = np.array([0.0, 0.0, 1.2]) - (a + b + c) / 3
                assert np.cross(b - a, c - a) @ inward > 0, m.name
                assert (m.parts == part_labels.ROOM).all()


def test_the_window_is_on_the_side_the_light_comes_from(rooms):
    for place in rooms:
        window = next(m for m in place.meshes if m.name == "window")
        assert window.vertices.mean(axis=0)[:2] @ place.light.direction[:2] < 0


def test_unknown_names_and_radii_raise():
    with pytest.raises(InputError, match=r"room, studio, .* street, grass, court"):
        make_place("kitchen", np.random.default_rng(0))
    with pytest.raises(InputError, match=r"0\.5 to 15"):
        make_place("room", np.random.default_rng(0), 0.0)


@pytest.mark.parametrize("make", [*textures.FLOORS, *textures.WALLS, textures.wood, textures.cloth])
def test_surfaces_join_at_their_edges(make):
    """The step across the seam is no larger than the usual step between rows."""
    texture = make(np.random.default_rng(2)).texture.astype(float).mean(-1)
    for t in (texture, texture.T):
        steps = np.abs(np.diff(t, axis=0)).mean(axis=1)
        assert np.abs(t[0] - t[-1]).mean() <= steps.max() * 1.2 + 4


def test_shapes_are_closed_and_face_outward():
    grey = textures.even(0.5)
    shapes = {
        0.024: box("b", (1, 2, 3), (0.2, 0.3, 0.4), grey),
        np.pi * 0.04: cylinder("c", (5, 0, 0), 0.2, 1.0, grey, sides=200),
        4 / 3 * np.pi * 0.024: ball("e", (0, 0, 9), (0.2, 0.3, 0.4), grey, rings=60),
    }
    for volume, m in shapes.items():
        a, b, c = (m.vertices[m.faces[:, i]] for i in range(3))
        assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=5e-3)


def test_a_sheet_shows_its_first_row_on_top():
    m = sheet(
        "s",
        (0, 1, 1),
        (0, -2, 0),
        (0, 0, -1),
        Material(np.zeros((2, 2, 3), np.uint8), tile=0.5),
        tiled=True,
    )
    top = m.vertices[:, 2] == 1
    assert (m.uv[top, 1] == 0).all() and m.uv[:, 0].max() == 4 and m.uv[:, 1].max() == 2


def test_dusk_is_darker_redder_and_lower():
    day = make_place("street", np.random.default_rng(3))
    dusk = at_dusk(day)
    assert dusk.light.color.sum() < 0.6 * day.light.color.sum()
    assert dusk.light.color[0] / dusk.light.color[2] > day.light.color[0] / day.light.color[2]
    assert day.light.direction[2] < dusk.light.direction[2] < -0.3
    sky = [next(m for m in p.meshes if m.name == "sky").texture.mean() for p in (day, dusk)]
    assert sky[1] < 0.5 * sky[0]


def test_user_pictures_cover_the_walls(tmp_path):
    cv2.imwrite(str(tmp_path / "red.png"), np.full((30, 40, 3), (0, 0, 255), np.uint8))
    room = make_place("room", np.random.default_rng(1))
    covered = with_pictures(room, picture_files(tmp_path), np.random.default_rng(0))
    for before, after in zip(room.meshes, covered.meshes, strict=True):
        if before.name in ("wall", "floor"):
            assert (after.texture == [255, 0, 0]).all()
        elif before.name == "skirting":
            assert after.texture is before.texture


def test_broken_picture_raises_with_its_path(tmp_path):
    with pytest.raises(FileError, match="no such folder"):
        picture_files(tmp_path / "none")
    with pytest.raises(FileError, match="has no pictures"):
        picture_files(tmp_path)
    for content in (b"", b"not a picture"):
        (tmp_path / "broken.jpg").write_bytes(content)
        with pytest.raises(FileError, match=r"broken\.jpg: is not a readable picture"):
            read_picture(picture_files(tmp_path)[0])


@pytest.mark.parametrize("seed", range(40))
def test_books_stand_between_the_sides_of_their_shelf(seed):
    meshes = furniture.shelf(np.random.default_rng(seed))
    inside = max(abs(m.vertices[:, 0]).max() for m in meshes if m.name == "shelf side") - 0.02
    books = [m for m in meshes if m.name == "books"]
    assert books and all(abs(m.vertices[:, 0]).max() <= inside + 1e-9 for m in books)
