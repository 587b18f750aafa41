"""The atlas against the camera it was built for: every pixel's ray must come back out of it."""

from __future__ import annotations

import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap_sim.render.fisheye import build_atlas


def _equidistant(width: int, height: int, degrees: float) -> Camera:
    f = max(width, height) / 2 / np.radians(degrees / 2)
    return Camera(
        "equidistant", width, height, ((width - 1) / 2, (height - 1) / 2), ((f, 0.0), (0.0, f)),
        max_angle=np.radians(degrees / 2),
    )  # fmt: skip


def _ocam(width: int, height: int) -> Camera:
    scale = width / 1280
    polynomial = [-420.0, 0.0, 7.5e-4, -4e-7, 6e-10]
    return Camera(
        "ocam", width, height, (644.1 * scale, 507.3 * scale), ((1.0, 2e-4), (-3e-4, 1.0)),
        tuple(a / scale ** (i - 1) for i, a in enumerate(polynomial)), max_angle=np.radians(92),
    )  # fmt: skip


CAMERAS = {
    "180": _equidistant(160, 128, 180),
    "200": _equidistant(150, 150, 200),
    "90": _equidistant(96, 96, 90),
    "ocam": _ocam(160, 128),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_looking_up_the_atlas_gives_the_ray_back(name):
    camera = CAMERAS[name]
    atlas = build_atlas([camera])
    y, x = np.nonzero(atlas.inside[0])
    rays, valid = camera.ray(np.stack([x, y], -1).astype(float))
    assert valid.all() and len(x) > 0.5 * camera.width * camera.height
    at = atlas.lookup[0][y, x].astype(float)
    found = np.zeros(len(at), int)
    for t in atlas.tiles:
        low, high = (t.column, t.row), (t.column + t.width - 1, t.row + t.height - 1)
        mine = np.all((at >= low) & (at <= high), -1)
        u = t.slopes[0] + (at[mine, 0] + 0.5 - t.column) / t.density
        v = t.slopes[3] - (at[mine, 1] + 0.5 - t.row) / t.density
        back = np.stack([u, v, np.ones_like(u)], -1) @ t.R_camera_face.T
        back /= np.linalg.norm(back, axis=-1, keepdims=True)
        np.testing.assert_allclose(back, rays[mine], atol=2e-5)
        found[mine] += 1
    assert (found == 1).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_directions_are_located_where_their_pixels_look(name):
    camera = CAMERAS[name]
    atlas = build_atlas([camera])
    y, x = (a[::37] for a in np.nonzero(atlas.inside[0]))
    rays, _ = camera.ray(np.stack([x, y], -1).astype(float))
    tile, at = atlas.locate(0, rays)
    assert (tile >= 0).all()
    np.testing.assert_allclose(at, atlas.lookup[0][y, x], atol=2e-3)


def test_only_faces_the_lens_sees_are_drawn():
    assert len(build_atlas([CAMERAS["90"]]).tiles) == 1
    four = build_atlas([CAMERAS["180"]])
    assert len(four.tiles) == 4
    assert min(t.R_camera_face[2, 2] for t in four.tiles) > -1e-9  # none looks back
    assert len(build_atlas([CAMERAS["200"]]).tiles) in (5, 6)


def test_behind_the_lens_nothing_is_located():
    atlas = build_atlas([CAMERAS["180"]])
    assert atlas.locate(0, np.array([[0.0, 0.1, -1.0]]))[0][0] == -1


def test_tiles_do_not_overlap_and_pixels_between_views_are_apart():
    atlas = build_atlas([CAMERAS["180"], CAMERAS["ocam"]])
    used = np.zeros((atlas.height, atlas.width), int)
    for t in atlas.tiles:
        used[t.row : t.row + t.height, t.column : t.column + t.width] += 1
    assert used.max() == 1
    assert {t.view for t in atlas.tiles} == {0, 1}
    assert (used[atlas.needed] <= 1).all() and atlas.needed.any()


def test_outside_the_lens_is_outside_the_atlas():
    atlas = build_atlas([CAMERAS["180"]])
    assert not atlas.inside[0][0, 0]  # a corner, beyond 90 degrees
    assert (atlas.lookup[0][~atlas.inside[0]] < -1).all()


def test_a_larger_face_gives_a_larger_atlas():
    small, large = (build_atlas([CAMERAS["180"]], face_size=n) for n in (64, 128))
    assert 1.7 < large.tiles[0].width / small.tiles[0].width < 2.1


def test_less_sharpness_gives_a_smaller_atlas_of_the_same_directions():
    sharp, coarse = (build_atlas([CAMERAS["180"]], sharpness=s) for s in (1.0, 0.5))
    assert 1.7 < sharp.tiles[0].width / coarse.tiles[0].width < 2.1
    for a, b in zip(sharp.tiles, coarse.tiles, strict=True):
        assert np.allclose(a.slopes, b.slopes, atol=6 / b.density)
