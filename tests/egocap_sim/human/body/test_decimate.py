"""Decimation keeps closed surfaces closed, in place and with their texture coordinates."""

import numpy as np

from egocap_sim.human.body.decimate import decimate
from egocap_sim.human.body.skin_maps import openness


def sphere(n=24):
    """A closed ball of radius 1 and its texture corners, which wrap without a seam."""
    turn, rise = np.meshgrid(np.arange(n) / n, np.arange(1, n) / n, indexing="ij")
    theta, phi = 2 * np.pi * turn.ravel(), np.pi * rise.ravel()
    ring = np.stack([np.cos(theta) * np.sin(phi), np.sin(theta) * np.sin(phi), -np.cos(phi)], 1)
    points = np.concatenate([ring, [[0, 0, -1.0], [0, 0, 1.0]]])
    i = np.arange(n * (n - 1)).reshape(n, n - 1)
    a, b, c, d = (x.ravel() for x in (i[:, :-1], np.roll(i, -1, 0)[:, :-1],
                                      np.roll(i, -1, 0)[:, 1:], i[:, 1:]))  # fmt: skip
    low = np.stack([np.full(n, len(ring)), np.roll(i, -1, 0)[:, 0], i[:, 0]], 1)
    high = np.stack([np.full(n, len(ring) + 1), i[:, -1], np.roll(i, -1, 0)[:, -1]], 1)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1), low, high])
    return points, faces


def test_ball_stays_a_ball():
    points, faces = sphere()
    few, uv, rows = decimate(points, faces, faces.copy(), np.ones(len(points), bool), 600)
    assert len(faces) - len(few) == 600
    assert (few == uv).all()  # corners take the texture of the vertex they moved to
    assert len(rows) == len(few)
    edges = np.concatenate([few[:, [0, 1]], few[:, [1, 2]], few[:, [2, 0]]])
    forward = {tuple(e) for e in edges.tolist()}
    assert len(forward) == len(edges)
    assert {(b, a) for a, b in forward} == forward  # closed, and every triangle turned alike
    a, b, c = (points[few[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert 0.93 * 4 * np.pi / 3 < volume < 4 * np.pi / 3


def test_only_removable_vertices_are_removed():
    points, faces = sphere()
    removable = points[:, 2] > 0.2
    few, _, _ = decimate(points, faces, faces.copy(), removable, 10_000)
    assert set(np.flatnonzero(~removable)) <= set(few.ravel().tolist())
    assert len(few) < 0.8 * len(faces)


def test_an_occluder_above_reduces_openness():
    points, faces = sphere()
    points = 0.1 * points
    assert openness(points, faces).min() > 0.8  # nothing shades a ball alone
    both = np.concatenate([points, 0.4 * points + [0, 0, 0.18]])
    light = openness(both, np.concatenate([faces, faces + len(points)]))
    assert light[points[:, 2].argmax()] < 0.7
    assert light[points[:, 2].argmin()] > 0.85
