"""Panoramas: seamless, correctly oriented; invalid files raise."""

import cv2
import numpy as np
import pytest

from egocap.errors import FileError
from egocap_sim.environment.panorama import (
    HEIGHT,
    WIDTH,
    dome,
    make_panorama,
    read_panorama,
    with_panorama,
)
from egocap_sim.environment.places import make_place


def colour_towards(meshes, direction) -> np.ndarray:
    """The dome's colour at the vertex nearest to a direction."""
    best, colour = -2.0, None
    for m in meshes:
        k = int((m.vertices @ direction).argmax())
        if (m.vertices[k] @ direction) > best:
            best = float(m.vertices[k] @ direction)
            h, w = m.texture.shape[:2]
            colour = m.texture[int(m.uv[k, 1] * h), int(m.uv[k, 0] * w)]
    return colour


def test_procedural_panorama_is_bright_above_and_periodic():
    image = make_panorama(np.random.default_rng(4))
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    assert image[:300].mean() > image[700:].mean() + 20
    step = np.abs(np.diff(image.astype(int), axis=1)).mean()
    seam = np.abs(image[:, 0].astype(int) - image[:, -1]).mean()
    assert seam < 4 * step + 3
    assert image[480:512].std() > 8  # something stands along the horizon


def test_the_dome_shows_each_direction_where_it_is():
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:, WIDTH // 2 - 20 : WIDTH // 2 + 20, 0] = 255  # ahead: red
    image[:, WIDTH // 4 - 20 : WIDTH // 4 + 20, 1] = 255  # left: green
    image[:40, :, 2] = 255  # above: blue
    meshes = dome(image)
    assert colour_towards(meshes, np.array([1.0, 0.0, 0.0]))[0] == 255
    assert colour_towards(meshes, np.array([0.0, 1.0, 0.0]))[1] == 255
    assert colour_towards(meshes, np.array([0.0, 0.0, 1.0]))[2] == 255
    for m in meshes:  # seen from inside
        a, b, c = (m.vertices[m.faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        good = np.linalg.norm(normal, axis=1) > 1e-6
        assert ((normal * a).sum(1)[good] < 0).all()


def test_a_users_panorama_replaces_the_sky(tmp_path):
    path = tmp_path / "view.png"
    cv2.imwrite(str(path), np.full((60, 120, 3), (10, 20, 200), np.uint8))
    place = with_panorama(make_place("outdoor", np.random.default_rng(1)), read_panorama(path))
    skies = [m for m in place.meshes if m.name == "sky"]
    assert len(skies) == 8 and all((m.texture == (200, 20, 10)).all() for m in skies)


def test_invalid_panorama_raises(tmp_path):
    square, broken = tmp_path / "square.png", tmp_path / "broken.png"
    cv2.imwrite(str(square), np.zeros((50, 50, 3), np.uint8))
    broken.write_bytes(b"nothing")
    with pytest.raises(FileError, match=r"50 x 50.*twice as wide"):
        read_panorama(square)
    for path in (broken, tmp_path / "missing.png"):
        with pytest.raises(FileError):
            read_panorama(path)
