"""The renderer against scenes whose right picture is known."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap import geometry
from egocap.errors import InputError
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import Actor, Material, Mesh
from egocap_sim.assets.primitives import ball, box, sheet
from egocap_sim.core import part_labels

from .conftest import equidistant, looking_forward, place_of, plain_light

GREY = textures.even(0.6)
RED, GREEN = (textures.even(np.array(c)) for c in ([0.9, 0.1, 0.1], [0.1, 0.8, 0.1]))
HEAD = geometry.rigid(np.eye(3), np.array([0.0, 0.0, 1.5]))


def _floor(size: float = 20.0, material=GREY) -> Mesh:
    return sheet("floor", (-size, size, 0), (2 * size, 0, 0), (0, -2 * size, 0), material)


def _draw(gl, place, actors=(), skinning=None, camera=None, samples=0):
    renderer = gl.FisheyeRenderer(
        looking_forward(camera or equidistant()), actors, place, samples=samples
    )
    return renderer, renderer.render(HEAD, skinning or {})


def test_nothing_is_mirrored_and_textures_stand_upright(gl):
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :32], texture[:32, 32:] = (250, 0, 0), (0, 250, 0)
    texture[32:, :32], texture[32:, 32:] = (0, 0, 250), (250, 250, 250)
    # A poster ahead, 2 m wide: from the viewer its left is +y.
    poster = sheet("poster", (2, 1, 2.5), (0, -2, 0), (0, 0, -2), Material(texture))
    renderer, views = _draw(gl, place_of(poster))
    with renderer:
        image = views.images[0]
        at = {(-1, -1): (250, 0, 0), (1, -1): (0, 250, 0), (-1, 1): (0, 0, 250)}
        for (right, down), colour in (at | {(1, 1): (250, 250, 250)}).items():
            pixel = image[320 + 40 * down, 320 + 40 * right]
            np.testing.assert_allclose(pixel, colour, atol=3)


def test_depth_of_a_floor_is_the_distance_along_the_ray(gl):
    renderer, views = _draw(gl, place_of(_floor()))
    with renderer:
        depth = views.depth()[0]
        camera = renderer.rig.mounts[0].camera
    y, x = np.mgrid[330:640:10, 20:620:10]
    rays, valid = camera.ray(np.stack([x, y], -1).astype(float))
    expected = np.where(rays[..., 1] > 0, 1.5 / np.maximum(rays[..., 1], 1e-9), np.inf)
    near = valid & (expected < 8)
    # The nearest atlas pixel looks up to 0.3 image pixels past, which matters at grazing angles.
    slack = 0.002 + 0.005 * expected[near] ** 2
    assert near.sum() > 500 and (abs(depth[y, x][near] - expected[near]) < slack).all()
    assert np.isinf(depth[0, 320]) and depth.dtype == np.float32


@pytest.mark.parametrize("kind", ["square", "grass"])
def test_the_sky_has_no_holes_at_the_edge_of_the_largest_place(gl, kind):
    from egocap_sim.environment.places import LARGEST_RADIUS_M, make_place

    place = make_place(kind, np.random.default_rng(4), clear_radius=LARGEST_RADIUS_M)
    place = replace(place, background=np.array([1.0, 0.0, 1.0]))
    away = geometry.rigid(np.diag([-1.0, -1.0, 1.0]), np.array([LARGEST_RADIUS_M, 0.0, 1.5]))
    with gl.FisheyeRenderer(looking_forward(equidistant(320, 320)), [], place) as renderer:
        image = renderer.render(away, {}).images[0].astype(int)
    assert not ((image[..., ::2].min(-1) > 230) & (image[..., 1] < 40)).any()


@pytest.mark.parametrize("samples", [0, 4])
def test_labels_are_exact_up_to_a_pixel_at_outlines(gl, samples):
    rng = np.random.default_rng(1)
    centres = np.array([2.0, 0, 1.5]) + rng.uniform(-1.2, 1.2, (8, 3))
    labels = np.array([1, 7, 21, 40, 101, 102, 200, 255])
    balls = [
        ball("b", c, (0.3,) * 3, replace(GREY, part=int(p)), rings=40)
        for c, p in zip(centres, labels, strict=True)
    ]
    renderer, views = _draw(gl, place_of(*balls), samples=samples)
    with renderer:
        drawn = views.parts()[0]
        camera = renderer.rig.mounts[0].camera
    y, x = np.mgrid[0:640:3, 0:640:3]
    rays, _ = camera.ray(np.stack([x, y], -1).astype(float))
    to_ball = (centres - [0, 0, 1.5])[:, [1, 2, 0]] * [-1, -1, 1]  # head axes to camera axes
    along = rays @ to_ball.T
    gap = np.sqrt(np.maximum((to_ball**2).sum(-1) - along**2, 0))
    depth = np.where(gap < 0.3, along - np.sqrt(np.maximum(0.09 - gap**2, 0)), 99.0)
    expected = np.where(depth.min(-1) < 99, labels[depth.argmin(-1)], 0)
    wrong = drawn[y, x] != expected
    assert wrong.mean() < 0.004
    assert set(np.unique(drawn)) <= {0, *labels.tolist()}
    inside = np.sort(depth, -1)
    clear = (np.abs(gap - 0.3).min(-1) > 0.02) & (
        (inside[..., 1] - inside[..., 0] > 0.02) | (inside[..., 0] == 99)
    )
    assert not wrong[clear].any()


def test_surface_at_agrees_with_the_whole_pictures(gl):
    renderer, views = _draw(gl, place_of(_floor(), box("b", (1, 0.4, 0.5), (0.5, 0.5, 1), RED)))
    with renderer:
        pixels = np.random.default_rng(0).integers(0, 640, (40, 2))
        distance, part = views.surface_at(0, pixels.astype(float))
        np.testing.assert_array_equal(part, views.parts()[0][pixels[:, 1], pixels[:, 0]])
        expected = views.depth()[0][pixels[:, 1], pixels[:, 0]]
        np.testing.assert_allclose(distance, expected, rtol=1e-5)
        outside = views.surface_at(0, np.array([[-3.0, 5.0], [2.0, 2.0]]))
        assert np.isinf(outside[0]).all() and (outside[1] == 0).all()


def test_shadow_falls_away_from_the_light(gl):
    light = plain_light(ambient=0.2, color=0.6)
    slanted = geometry.unit(np.array([0.0, -1.0, -1.0]))  # comes from the left
    light = type(light)(slanted, light.color, light.sky, light.ground, light.sky_axis)
    cube = box("b", (1.0, 0.0, 0.5), (0.3, 0.3, 0.2), RED)  # floats 0.4 m over the floor
    renderer, views = _draw(gl, place_of(_floor(), cube, light=light))
    with renderer:
        image = views.images[0][..., 1].astype(float)
        camera = renderer.rig.mounts[0].camera

    def brightness(x, y):
        (u, v), seen = camera.project(np.array([-y, 1.5, x]))
        assert seen
        return image[round(v), round(u)]

    in_shadow, lit, mirrored = brightness(1, -0.5), brightness(1, -1.5), brightness(1, 0.5)
    assert in_shadow < 0.75 * lit and abs(mirrored - lit) < 2
    # Out of the light the floor has ambient light alone: colours are square roots of light, then
    # bent by the camera's tone curve.
    floor = _floor().texture[0, 0, 1] / 255.0
    dark, bright = (tone(floor * np.sqrt(0.2 + direct)) for direct in (0.0, 0.6 * np.sqrt(0.5)))
    assert in_shadow / lit == pytest.approx(dark / bright, abs=0.02)


def tone(value: float) -> float:
    """The curve of mesh.frag: 0, a half and 1 stay."""
    return value * (0.72 + value * (0.84 - 0.56 * value))


def test_a_lens_of_200_degrees_sees_behind_itself(gl):
    angle = np.radians(97)
    at = np.array([np.cos(angle), np.sin(angle), 0.0]) * 2 + [0, 0, 1.5]
    camera = equidistant(degrees=200)
    small = ball("b", at, (0.1,) * 3, replace(RED, part=102))
    renderer, views = _draw(gl, place_of(small), camera=camera)
    with renderer:
        rows, columns = np.nonzero(views.parts()[0] == 102)
        (u, v), seen = camera.project(np.array([-np.sin(angle), 0.0, np.cos(angle)]))
    assert seen and len(rows) > 20
    assert abs(columns.mean() - u) < 1.5 and abs(rows.mean() - v) < 1.0


def _skinned_ball() -> Actor:
    mesh = ball("limb", (1.5, 0, 1.5), (0.1,) * 3, replace(RED, part=9))
    n = len(mesh.vertices)
    bones, weights = np.tile([1, 0, 0, 0], (n, 1)), np.tile([1.0, 0, 0, 0], (n, 1))
    return Actor("wearer", (Mesh(**(vars(mesh) | {"bones": bones, "weights": weights})),))


def test_actors_follow_their_transforms(gl):
    S = np.tile(np.eye(4), (2, 1, 1))
    S[1, :3, 3] = [0, 0.5, 0]  # to the left
    renderer, views = _draw(gl, place_of(), [_skinned_ball()], {"wearer": S})
    with renderer:
        rows, columns = np.nonzero(views.parts()[0] == 9)
        u = 319.5 - np.arctan2(0.5, 1.5) * 320 / (np.pi / 2)
        assert abs(columns.mean() - u) < 1 and abs(rows.mean() - 319.5) < 1
        with pytest.raises(InputError, match="wearer"):
            renderer.render(HEAD, {})
        with pytest.raises(InputError, match="2 bones"):
            renderer.render(HEAD, {"wearer": S[:1]})


def test_views_of_an_earlier_frame_are_refused(gl):
    renderer, views = _draw(gl, place_of(_floor()))
    with renderer:
        renderer.render(HEAD, {})
        with pytest.raises(RuntimeError, match="another frame"):
            views.parts()


def test_two_actors_of_one_name_are_refused(gl):
    with pytest.raises(InputError, match="different names"):
        gl.FisheyeRenderer(
            looking_forward(equidistant()), [_skinned_ball(), _skinned_ball()], place_of()
        )


def test_what_was_drawn_before_leaves_no_trace(gl):
    """Contexts are kept for the next renderer: of another place, size and number of samples."""
    from egocap_sim.environment.places import make_place

    def picture(kind: str, camera, samples: int = 0) -> bytes:
        place = make_place(kind, np.random.default_rng(4))
        still = {"wearer": np.tile(np.eye(4), (2, 1, 1))}
        renderer, views = _draw(gl, place, [_skinned_ball()], still, camera, samples)
        with renderer:
            planes = (*views.images, *views.parts(), *views.depth())
            return b"".join(plane.tobytes() for plane in planes)

    alone = picture("room", equidistant(320, 256))
    for kind, camera, samples in (("street", equidistant(200, 200, 150.0), 4),
                                  ("chroma", equidistant(64, 64), 0)):  # fmt: skip
        picture(kind, camera, samples)
        assert picture("room", equidistant(320, 256)) == alone


@pytest.mark.parametrize("samples", [0, 4])
def test_the_same_inputs_give_the_same_bytes(gl, samples):
    from egocap_sim.environment.places import make_place

    pictures = []
    for _ in range(2):
        place = make_place("room", np.random.default_rng(4))
        renderer, views = _draw(gl, place, camera=equidistant(320, 256), samples=samples)
        with renderer:
            pictures.append(views.images[0].tobytes())
            pictures.append(renderer.render(HEAD, {}).images[0].tobytes())
    assert len(set(pictures)) == 1


@pytest.mark.parametrize("samples", [0, 4])
def test_images_asked_for_late_or_in_another_thread_are_the_same(gl, samples):
    place = place_of(_floor(), box("b", (1, 0.4, 0.5), (0.5, 0.5, 1), GREEN))
    poses = [HEAD + np.eye(4, k=3) * 0.03 * i for i in range(4)]
    renderer, _ = _draw(gl, place, samples=samples)
    with renderer, ThreadPoolExecutor(1) as pool:
        at_once = [renderer.render(pose, {}).images[0] for pose in poses]
        late = [renderer.render(pose, {}) for pose in poses]
        there = [pool.submit(lambda v: v.images, renderer.render(pose, {})) for pose in poses]
        for image, views, future in zip(at_once, late, there, strict=True):
            assert np.array_equal(image, views.images[0])
            assert np.array_equal(image, future.result()[0])
    assert not np.array_equal(at_once[0], at_once[-1])


def test_anti_aliasing_only_touches_outlines(gl):
    place = place_of(_floor(), box("b", (1, 0.4, 0.5), (0.5, 0.5, 1), GREEN))
    images = []
    for samples in (0, 4):
        renderer, views = _draw(gl, place, samples=samples)
        with renderer:
            images.append(views.images[0].astype(int))
    different = np.abs(images[0] - images[1]).max(-1) > 3
    assert 0 < different.mean() < 0.02


def test_memory_does_not_grow(gl):
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("no /proc here")
    S = np.tile(np.eye(4), (2, 1, 1))
    renderer, _ = _draw(
        gl, place_of(_floor()), [_skinned_ball()], {"wearer": S}, camera=equidistant(160, 160)
    )
    with renderer:
        sizes = []
        for i in range(300):
            S[1, 1, 3] = np.sin(i)
            views = renderer.render(HEAD, {"wearer": S})
            views.surface_at(0, np.full((18, 2), 80.0))
            views.depth()
            sizes.append(int(statm.read_text().split()[1]) * 4096)
    assert sizes[-1] - sizes[100] < 4e6


def test_closing_twice_is_harmless_and_another_renderer_still_works(gl):
    first, _ = _draw(gl, place_of(_floor()), camera=equidistant(64, 64))
    second, views = _draw(gl, place_of(_floor()), camera=equidistant(64, 64))
    first.close()
    first.close()
    with second:
        again = second.render(HEAD, {})
        np.testing.assert_array_equal(views.images[0], again.images[0])
        assert (again.parts()[0] == part_labels.ROOM).any()
