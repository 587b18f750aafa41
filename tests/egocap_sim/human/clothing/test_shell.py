"""Cutting and turning cloth: areas against closed forms, borders."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap_sim.human.clothing.shell import border, clip


def grid(n):
    """A unit square of 2 n^2 triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    i = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel(), y.ravel()], 1), faces


def area(points, faces):
    p = points[faces]
    u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    signed = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    assert signed.min() >= -1e-12  # no triangle is turned over
    return signed.sum()


@settings(deadline=None, max_examples=40)
@given(st.floats(0, 2 * np.pi), st.floats(-0.6, 0.6))
def test_clip_splits_the_area_in_two(angle, offset):
    points, faces = grid(6)
    value = (points - 0.5) @ [np.cos(angle), np.sin(angle)] - offset + 1e-4
    total = 0.0
    for side in (value, -value):
        cut, mix = clip(faces, side)
        if len(cut):
            assert np.asarray(mix.sum(1)).ravel() == pytest.approx(1)
            assert (mix @ side).min() > -1e-9
            total += area(mix @ points, cut)
    assert total == pytest.approx(1.0, abs=1e-6)


def test_clip_shares_cut_vertices():
    points, faces = grid(4)
    cut, mix = clip(faces, 0.6 - points[:, 0])
    edge = border(cut)
    placed = mix @ points
    on_cut = np.abs(placed[edge, 0] - 0.6).max(1) < 1e-9
    outer = ((placed[edge] == 0) | (placed[edge] == 1)).all(1).any(1)
    assert (on_cut | outer).all()  # no cracks inside


def test_border_of_a_square():
    _, faces = grid(3)
    assert len(border(faces)) == 12
