"""Merging and skinning against the formula, written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egocap import geometry
from egocap.errors import InputError
from egocap_sim.assets import textures
from egocap_sim.assets.primitives import ball, box, sheet
from egocap_sim.render.batch import merge
from egocap_sim.render.projection import intersects_frustum, light_projection, tile_projection

GREY = textures.even(0.5)
RED = textures.even(np.array([1.0, 0.0, 0.0]))


def _skinned(rng):
    mesh = ball("m", (0, 0, 1), (0.3, 0.2, 0.4), GREY, rings=6)
    n = len(mesh.vertices)
    weights = rng.dirichlet(np.ones(4), n)
    return replace(mesh, bones=rng.integers(0, 5, (n, 4)), weights=weights)


def test_posing_is_linear_blend_skinning():
    rng = np.random.default_rng(0)
    mesh, still = _skinned(rng), box("b", (1, 0, 0), (1, 1, 1), GREY)
    turns = geometry.axis_angle(geometry.unit(rng.normal(size=(5, 3))), rng.uniform(0, 3, 5))
    S = geometry.rigid(turns, rng.normal(size=(5, 3)))
    batch = merge([mesh, still])
    positions, normals = batch.pose(S)
    homogeneous = np.c_[mesh.vertices, np.ones(len(mesh.vertices))]
    expected = np.einsum("nk,nkij,nj->ni", mesh.weights, S[mesh.bones], homogeneous)[:, :3]
    stacked = positions[np.argsort(batch.order)]
    np.testing.assert_allclose(stacked[: len(expected)], expected, atol=2e-6)
    np.testing.assert_allclose(stacked[len(expected) :], still.vertices, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    low, high = batch.boxes(positions)
    for c, lo, hi in zip(batch.chunks, low, high, strict=True):
        inside = positions[np.unique(batch.faces.ravel()[c.first : c.first + c.count])]
        np.testing.assert_array_equal((lo, hi), (inside.min(0), inside.max(0)))


def test_too_few_transforms_are_refused():
    batch = merge([_skinned(np.random.default_rng(0))])
    with pytest.raises(InputError, match="5 bones"):
        batch.pose(np.tile(np.eye(4), (4, 1, 1)))


def test_every_triangle_is_in_one_chunk_and_casters_are_marked():
    meshes = [
        box("b", (1, 0, 0), (1, 1, 1), GREY),
        sheet("s", (0, 0, 0), (5, 0, 0), (0, 5, 0), RED),
        replace(sheet("d", (0, 0, 3), (1, 0, 0), (0, 1, 0), RED), double_sided=True),
    ]
    batch = merge(meshes)
    assert len(batch.faces) == 12 + 2 + 2
    assert sum(c.count for c in batch.chunks) == batch.faces.size
    assert sum(c.count for c in batch.chunks if c.casts_shadow) == 3 * 12
    assert [c.count for c in batch.chunks if c.double_sided] == [3 * 2]
    assert len(batch.layers) == 2


def test_the_inside_of_a_sleeve_is_drawn_near_its_ends_only():
    turn, along = np.meshgrid(np.linspace(0, 2 * np.pi, 13), np.linspace(0, 1, 21))
    vertices = np.stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), along], -1).reshape(-1, 3)
    k = (np.arange(20)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate([np.c_[k, k + 1, k + 14], np.c_[k, k + 14, k + 13]])
    n = len(vertices)
    sleeve = replace(
        ball("s", (0, 0, 0), (1, 1, 1), RED), vertices=vertices, faces=faces, uv=vertices[:, :2],
        parts=np.ones(n, np.uint8), double_sided=True,
    )  # fmt: skip
    batch = merge([sleeve])
    middle = batch.positions[batch.faces].mean(axis=1)[:, 2]
    for c in batch.chunks:
        at = middle[c.first // 3 : (c.first + c.count) // 3]
        assert (
            (np.minimum(at, 1 - at) < 0.2).all() if c.double_sided else (abs(at - 0.5) < 0.36).all()
        )
    assert {c.double_sided for c in batch.chunks} == {True, False}


def test_skin_is_smooth_across_seams_and_boxes_keep_their_edges():
    ball_mesh = _skinned(np.random.default_rng(0))
    batch = merge([ball_mesh])
    welded = {}
    for v, n in zip(np.round(batch.positions, 6).tolist(), batch.normals, strict=True):
        np.testing.assert_allclose(welded.setdefault(tuple(v), n), n, atol=1e-6)
    flat = merge([box("b", (0, 0, 0), (1, 2, 3), GREY)]).normals
    np.testing.assert_allclose(np.abs(flat).max(axis=1), 1.0, atol=1e-6)


def test_culling_never_drops_a_box_that_shows():
    from egocap_sim.render.fisheye import build_atlas

    from .conftest import equidistant

    atlas = build_atlas([equidistant(64, 64)])
    rng = np.random.default_rng(0)
    low = rng.uniform(-3, 3, (400, 3))
    high = low + rng.uniform(0.01, 1.5, (400, 3))
    points = low[:, None] + (high - low)[:, None] * rng.uniform(size=(400, 60, 3))
    for tile in atlas.tiles:
        clip = tile_projection(tile, np.eye(4), 0.01, 50.0)
        p = np.c_[points.reshape(-1, 3), np.ones(24000)] @ clip.T
        shows = np.all(np.abs(p[:, :2]) < p[:, 3:], axis=1).reshape(400, 60).any(axis=1)
        seen = intersects_frustum(clip, low, high)
        assert (seen | ~shows).all()
        assert seen.mean() < 0.8


def test_the_shadow_square_moves_in_whole_pixels():
    direction = geometry.unit(np.array([0.3, 0.2, -1.0]))
    a, b = (light_projection(direction, np.array([x, 0.1, 1.5]), 1024) for x in (0.0, 0.123))
    shift = (a - b)[:2, 3] * 512
    np.testing.assert_allclose(shift, np.round(shift), atol=1e-6)
    np.testing.assert_allclose(a[:3, :3], b[:3, :3])
    ahead = a[:3, :3] @ -direction
    assert ahead[2] < 0 and abs(ahead[0]) < 1e-9  # towards the light is nearer
