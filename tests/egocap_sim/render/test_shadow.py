"""Shadows against geometry: how wide a penumbra is, and what must not be shaded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from egocap import geometry
from egocap_sim.assets import textures
from egocap_sim.assets.primitives import box, sheet
from egocap_sim.render.projection import TO_TEXTURE, ground_depth, light_projection

from .conftest import equidistant, looking_forward, place_of, plain_light

GREY = textures.even(0.6)
HEAD = geometry.rigid(np.eye(3), np.array([0.0, 0.0, 1.5]))
FLOOR = sheet("floor", (-20, 20, 0), (40, 0, 0), (0, -40, 0), GREY)


def brightness(gl, points, *meshes, **light):
    """Green of a floor's points [m], lit from above, beside things."""
    lit = replace(plain_light(ambient=0.2, color=0.6), **light)
    rig = looking_forward(equidistant(1600, 1600))
    with gl.FisheyeRenderer(rig, [], place_of(FLOOR, *meshes, light=lit)) as renderer:
        image = renderer.render(HEAD, {}).images[0][..., 1].astype(float)
    x, y = points.T
    pixels, seen = rig.cameras[0].project(np.stack([-y, np.full(len(x), 1.5), x], 1))
    assert seen.all()
    column, row = np.rint(pixels).astype(int).T
    return image[row, column]


def penumbra(gl, gap, **light):
    """Width [m] across the light between 10 and 90 % of it, beside a plate so far up the light."""
    down = geometry.unit(np.array([0.0, -1.0, -1.0]))
    height = gap * -down[2]
    y = np.linspace(-0.6, 0.3, 901)
    plate = box("plate", (2.0, height + 2.0, height), (3.0, 4.0, 0.02), GREY)  # its shadow: y > 0
    value = brightness(gl, np.stack([np.full_like(y, 2.0), y], 1), plate, direction=down, **light)
    share = (value.max() - value) / np.ptp(value)
    assert np.diff(share).min() > -0.05 and share[0] == 0.0 and share[-1] == 1.0
    return (np.interp(0.9, share, y) - np.interp(0.1, share, y)) * -down[2]


@pytest.mark.parametrize("gap", [0.5, 1.6])
@pytest.mark.parametrize("spread", [0.12, 0.2])
def test_a_penumbra_is_as_wide_as_the_light_is_seen_from_the_ground(gl, gap, spread):
    assert penumbra(gl, gap, spread=spread) == pytest.approx(0.8 * spread * gap, rel=0.25)


def test_the_suns_shadow_is_sharp(gl):
    assert penumbra(gl, 1.0) < 0.025


def test_a_bare_floor_does_not_shade_itself(gl):
    points = np.random.default_rng(0).uniform([0.5, -2.5], [3.0, 2.5], (500, 2))
    slanted = geometry.unit(np.array([0.4, -0.5, -1.0]))
    lit = brightness(gl, points, direction=slanted)  # sharp
    assert np.ptp(lit) <= 2
    np.testing.assert_allclose(brightness(gl, points, direction=slanted, spread=0.2), lit, atol=2)


def test_the_floors_depth_is_where_its_points_are():
    direction, size = geometry.unit(np.array([0.3, 0.2, -1.0])), 400
    clip = light_projection(direction, np.array([0.4, -0.2, 1.5]), size)
    floor = np.random.default_rng(0).uniform(-2, 2, (50, 2))
    u, v, depth = (TO_TEXTURE @ clip @ np.insert(floor, [2, 2], [0.0, 1.0], axis=1).T)[:3]
    first, right, up = ground_depth(clip, size).astype(float)
    at = first + right * (u * size - 0.5) + up * (v * size - 0.5)
    np.testing.assert_allclose(at, depth, atol=1e-6)
