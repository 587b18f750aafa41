"""The darkness under what touches the floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egocap import geometry
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Actor
from egocap_sim.assets.primitives import ball, sheet

from .conftest import equidistant, looking_forward, place_of

GREY = textures.even(0.6)
HEAD = geometry.rigid(np.eye(3), np.array([0.0, 0.0, 1.5]))


@pytest.fixture(scope="module")
def contact(gl):
    from egocap_sim.render import contact

    return contact


def test_the_light_left_grows_with_height_and_distance(contact):
    def least(height: float) -> int:
        return contact.make_contact_shadow(np.array([[2.0, -1.0, height]])).factor.min()

    heights = [least(h) for h in (0.0, 0.05, 0.1, 0.2)]
    assert heights == sorted(heights) and heights[0] < 200 < heights[-1]
    dark = contact.make_contact_shadow(np.array([[2.0, -1.0, 0.0], [2.1, -1.0, 0.0]]))
    row, column = np.unravel_index(dark.factor.argmin(), dark.factor.shape)
    x, y = dark.corner + contact.CELL_M * (np.array([column, row]) + 0.5)
    assert abs(x - 2.05) < 0.1 and abs(y + 1.0) < 0.05
    assert contact.make_contact_shadow(np.array([[0.0, 0.0, contact.HEIGHT_M]])) is None


def test_what_is_drawn_holds_all_that_is_dark(contact):
    for points in ([[0.0, 0, 0], [0.4, 0.3, 0.1]], [[-9.0, 0, 0], [9.0, 0, 0], [0.5, 0, 0]]):
        dark = contact.make_contact_shadow(np.array(points))
        (x0, y0), (x1, y1) = dark.first, dark.last
        assert min(x0, y0) >= 0 and max(x1, y1) <= contact.CELLS
        rest = dark.factor.copy()
        assert rest[y0:y1, x0:x1].min() < 200
        rest[y0 + 1 : y1 - 1, x0 + 1 : x1 - 1] = 255  # it ends without a step
        assert rest.min() == 255
    assert contact.make_contact_shadow(np.array([[-9.0, 0, 0], [9.0, 0, 0]])) is None


@pytest.mark.parametrize(("height", "darker"), [(0.1, True), (1.0, False)])
def test_only_the_floor_beside_a_low_ball_is_darkened(gl, height, darker):
    floor = sheet("floor", (-9, 9, 0), (18, 0, 0), (0, -18, 0), GREY)
    place = replace(place_of(floor), contact=True)
    thing = Actor("ball", (ball("ball", (1.2, 0.0, height), (0.1,) * 3, GREY),))
    with gl.FisheyeRenderer(looking_forward(equidistant()), [thing], place) as renderer:
        views = renderer.render(HEAD, {"ball": np.eye(4)[None]})
        image, parts, depth = views.images[0].copy(), views.parts()[0].copy(), views.depth()[0]
        at, _ = renderer.rig.mounts[0].camera.project(
            np.array([[-0.14, 1.5, 1.2], [-0.8, 1.5, 1.2], [0.0, 1.5 - height, 1.2]])
        )
        beside, away, itself = (int(image[y, x, 0]) for x, y in np.round(at).astype(int))
        renderer._contact = None
        plain = renderer.render(HEAD, {"ball": np.eye(4)[None]})
        np.testing.assert_array_equal(parts, plain.parts()[0])
        np.testing.assert_array_equal(depth, plain.depth()[0])
    assert (beside < 0.9 * away) == darker and abs(itself - away) < 0.1 * away
