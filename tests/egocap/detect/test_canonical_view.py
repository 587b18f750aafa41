"""Canonical views against the cameras' own projection, markers in pictures, and mirrored rigs."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, camera_rotation
from egocap.detect.canonical_view import CanonicalView, ViewSpec
from egocap.errors import InputError

SPECS = (ViewSpec(), ViewSpec(640, 512, 204.0, 0.0, 90.0, 0.0), ViewSpec(64, 64, 28.0))


def mounted(side: float, size=(640, 512), toe_out=8.0) -> Mount:
    width, height = size
    camera = Camera(
        "kannala_brandt", width, height, (width * 0.51, height * 0.49),
        ((0.32 * width, 0.0), (0.0, 0.32 * width)), (-0.02, 0.001, 0.0, 0.0), np.deg2rad(95),
    )  # fmt: skip
    if side < 0:  # the mirror image of the left camera
        camera = replace(camera, centre=(width - 1 - camera.centre[0], camera.centre[1]))
    T = np.eye(4)
    T[:3, :3] = camera_rotation(80.0, side * toe_out)
    T[:3, 3] = 0.25, 0.17 * side, 0.08
    return Mount("left" if side > 0 else "right", camera, T)


def in_front(forward: float) -> Mount:
    """The left camera, so many metres in front of the skull base."""
    mount = mounted(1.0)
    T = mount.T_head_camera.copy()
    T[0, 3] = forward
    return replace(mount, T_head_camera=T)


def points_below(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points about where a body is, in the head frame."""
    return rng.uniform((-0.5, -0.5, -1.6), (0.6, 0.5, -0.3), (count, 3))


def in_camera(mount: Mount, points: np.ndarray) -> np.ndarray:
    R, t = mount.T_head_camera[:3, :3], mount.T_head_camera[:3, 3]
    return (points - t) @ R


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_pixels_return_through_the_view(spec, side):
    mount = mounted(side)
    view = CanonicalView(mount, spec)
    rays = in_camera(mount, points_below(np.random.default_rng(0), 200))
    pixels, seen = mount.camera.project(rays)
    points, inside = view.to_view(pixels)
    assert (seen & inside).sum() > 100
    back, valid = view.to_camera(points[seen & inside])
    assert valid.all()
    np.testing.assert_allclose(back, pixels[seen & inside], atol=1e-6)


def test_axis_and_head_forward_are_where_the_spec_says():
    spec = ViewSpec(pitch_deg=90.0, toe_in_deg=0.0)
    down, forward, right = (0, 0, -1.0), (0.5, 0, -1.0), (0, -0.5, -1.0)
    points, _ = spec.points(np.array([down, forward, right]))
    centre = (np.array(spec.size) - 1) / 2
    np.testing.assert_allclose(points[0], centre, atol=1e-9)
    assert points[1, 1] < centre[1] - 10 and abs(points[1, 0] - centre[0]) < 1e-9
    assert points[2, 0] > centre[0] + 10 and abs(points[2, 1] - centre[1]) < 1e-9


@pytest.mark.parametrize("spec", SPECS)
def test_rays_undo_points_wherever_the_view_reaches(spec):
    v, u = np.mgrid[0 : spec.height : 7, 0 : spec.width : 7]
    points = np.stack([u, v], -1).astype(float)
    rays, defined = spec.rays(points)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1)[defined], 1.0)
    back, inside = spec.points(rays[defined])
    np.testing.assert_allclose(back, points[defined], atol=1e-5)
    assert inside.all()


def test_mirrored_body_in_mirrored_camera_looks_the_same():
    left, right = CanonicalView(mounted(1.0)), CanonicalView(mounted(-1.0))
    assert right.mirrored and not left.mirrored
    body = points_below(np.random.default_rng(1), 50)
    mirrored = body * (1, -1, 1)
    seen_left, _ = left.to_view(mounted(1.0).camera.project(in_camera(mounted(1.0), body))[0])
    seen_right, _ = right.to_view(
        mounted(-1.0).camera.project(in_camera(mounted(-1.0), mirrored))[0]
    )
    np.testing.assert_allclose(seen_left, seen_right, atol=1e-6)


def test_labels_swap_in_mirrored_views_only():
    names = np.array(LABELS)
    left, right = CanonicalView(mounted(1.0)), CanonicalView(mounted(-1.0))
    assert (left.labels(names, 0) == names).all()
    swapped = right.labels(names, 0)
    assert swapped[LABELS.index("left_foot")] == "right_foot" and swapped[0] == "head"
    assert (right.labels(swapped, 0) == names).all()


@pytest.mark.parametrize("size", [(640, 512), (1280, 1024), (2000, 1600)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_marker_lands_where_points_say(size, side):
    mount = mounted(side, size)
    view = CanonicalView(mount)
    target = np.array([150.0, 120.0])
    pixel, valid = view.to_camera(target)
    assert valid
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    v, u = np.mgrid[: size[1], : size[0]]
    spread = 3.0 * float(view.magnification(target))
    blob = np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / (2 * spread**2))
    picture[...] = np.rint(255 * blob)[..., None]
    seen = view.image(picture)[..., 1].astype(float)
    v, u = np.mgrid[: seen.shape[0], : seen.shape[1]]
    found = np.array([(u * seen).sum(), (v * seen).sum()]) / seen.sum()
    np.testing.assert_allclose(found, target, atol=0.1)


@pytest.mark.parametrize("size", [(640, 512), (1280, 1024), (1283, 1021), (2000, 1600)])
def test_labels_are_those_of_the_nearest_pixels(size):
    view = CanonicalView(mounted(1.0, size))
    v, u = np.mgrid[: size[1], : size[0]]
    parts = [view.image((a % 256).astype(np.uint8), nearest=True) for a in (u, v, u // 256)]
    points = np.argwhere(view.mask)[::50, ::-1]
    pixels, _ = view.to_camera(points)
    near = np.rint(pixels).astype(int)
    inside = ((near >= 0) & (near < size)).all(-1)
    assert inside.sum() > 500
    for found, wanted in zip(parts, (near[:, 0], near[:, 1], near[:, 0] // 256), strict=True):
        at = found[points[:, 1], points[:, 0]]
        np.testing.assert_array_equal(at, np.where(inside, wanted % 256, 0))


def test_magnification_is_the_ratio_of_lengths():
    view = CanonicalView(mounted(1.0))
    at = np.array([[140.0, 100.0], [100.0, 150.0]])
    ratio = view.magnification(at)
    for i, point in enumerate(at):
        ring = point + 0.5 * np.array([(np.cos(a), np.sin(a)) for a in np.arange(0, 6.28, 0.1)])
        pixels, _ = view.to_camera(ring)
        steps = np.linalg.norm(pixels - view.to_camera(point)[0], axis=1)
        assert np.exp(np.log(steps / 0.5).mean()) == pytest.approx(ratio[i], rel=0.02)


def test_what_the_camera_does_not_see_is_black_and_masked():
    view = CanonicalView(mounted(1.0))
    image = view.image(np.full((512, 640, 3), 255, np.uint8))
    assert 0.5 < view.mask.mean() < 0.99
    assert (image[~view.mask] == 0).all()


@pytest.mark.parametrize("shape, kind", [((480, 640, 3), np.uint8), ((512, 640, 3), np.uint16)])
def test_wrong_picture_is_refused(shape, kind):
    with pytest.raises(InputError, match=r"512, 640, 3.*uint8"):
        CanonicalView(mounted(1.0)).image(np.zeros(shape, kind))


def test_impossible_views_are_refused():
    with pytest.raises(InputError, match="compression"):
        ViewSpec(compression=2.0)
    with pytest.raises(InputError, match="8 to 2048"):
        ViewSpec(width=0)
    for focal in (0.0, -1.0):
        with pytest.raises(InputError, match=f"focal {focal}"):
            ViewSpec(boom_focal=focal)
    with pytest.raises(InputError, match="finite"):
        ViewSpec(boom_focal=float("nan"))


@pytest.mark.parametrize(
    "forward, pitch", [(0.05, 85.0), (0.14, 85.0), (0.20, 95.0), (0.30, 105.0)]
)
def test_axis_of_a_camera_near_the_face_points_farther_forward(forward, pitch):
    spec = ViewSpec(near_pitch_deg=85.0, toe_in_deg=0.0)
    axis = CanonicalView(in_front(forward), spec).spec.axes[2]
    assert np.degrees(np.arctan2(-axis[2], axis[0])) == pytest.approx(pitch)
    assert ViewSpec().mounted(forward) == ViewSpec()  # weights of views without the key


@pytest.mark.parametrize("forward, focal", [(0.14, 137.0), (0.25, 143.5), (0.40, 150.0)])
def test_camera_on_a_boom_is_magnified(forward, focal):
    mount, spec = in_front(forward), ViewSpec(boom_focal=150.0)
    middle = (np.array(spec.size) - 1.0) / 2.0
    plain, view = CanonicalView(mount), CanonicalView(mount, spec)
    ratio = plain.magnification(middle) / view.magnification(middle)
    assert ratio == pytest.approx(focal / 137.0, rel=1e-4)
    np.testing.assert_allclose(view.to_camera(middle)[0], plain.to_camera(middle)[0])
