"""Simplified meshes: fewer vertices, closed, at the same position."""

from dataclasses import replace

import numpy as np
import pytest

from egocap_sim.assets.mesh import Material
from egocap_sim.assets.mesh_simplify import simplify
from egocap_sim.assets.primitives import ball

GREY = Material(np.full((4, 4, 3), 128, np.uint8))


def volume(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def test_a_coarser_ball_is_smaller_but_keeps_its_size():
    fine = ball("b", (0, 0, 1), (0.5, 0.5, 0.5), GREY, rings=40)
    coarse = simplify(fine, 0.1)
    assert len(coarse.vertices) < len(fine.vertices) / 3
    assert volume(coarse) == pytest.approx(volume(fine), rel=0.1)
    assert coarse.faces.max() < len(coarse.vertices) == len(coarse.uv) == len(coarse.parts)


def test_seams_stay_closed():
    """Every edge of a closed surface has two sides, seen by position rather than by index."""
    coarse = simplify(ball("b", (0, 0, 1), (0.5, 0.5, 0.5), GREY, rings=40), 0.08)
    _, at = np.unique(coarse.vertices, axis=0, return_inverse=True)
    corners = at.reshape(-1)[coarse.faces]
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    assert {tuple(e) for e in edges} == {tuple(e[::-1]) for e in edges}


def test_vertices_of_different_bones_stay_apart():
    mesh = ball("b", (0, 0, 0), (0.5, 0.5, 0.5), GREY, rings=30)
    side = (mesh.vertices[:, 0] > 0.01).astype(int)
    bones = np.stack([side, 1 - side, side, side], -1)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(side), 1))
    coarse = simplify(replace(mesh, bones=bones, weights=weights), 0.3)
    right = coarse.bones[:, 0] == 1
    assert (coarse.vertices[right, 0] > 0.0).all() and (coarse.vertices[~right, 0] < 0.02).all()
