"""Cameras against OpenCV, OCamCalib's formulas, finite differences and autograd."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.cameras.camera import Camera
from egocap.cameras.camera_files import camera_from_dict
from egocap.errors import InputError

OCAM = (-283.0247, 0.0, 1.130153e-3, -1.870746e-7, 1.54814e-9)
KB = (0.05, -0.01, 0.004, -0.0005)
CAMERAS = {
    "equidistant": {"model": "equidistant", "width": 1280, "height": 1024,
                    "centre": (639.5, 511.5), "affine": ((400.0, 0.0), (0.0, 400.0)),
                    "max_angle": 2.0},
    "kannala_brandt": {"model": "kannala_brandt", "width": 1280, "height": 1024,
                       "centre": (630.2, 520.7), "affine": ((310.0, 1.5), (0.0, 305.0)),
                       "parameters": KB, "max_angle": 1.9},
    "ocam": {"model": "ocam", "width": 872, "height": 872, "centre": (436.57, 443.74),
             "affine": ((1.0, 9.4e-3), (-2e-2, 0.9998)), "parameters": OCAM, "max_angle": 1.95},
}  # fmt: skip


def made(name):
    return Camera(**CAMERAS[name])


@pytest.fixture(params=CAMERAS)
def camera(request):
    """Each camera in turn."""
    return made(request.param)


def rays_at(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def everywhere(camera, rng, n=4000, to=None):
    theta = rng.uniform(0.0, camera.max_angle if to is None else to, n)
    points = rays_at(theta, rng.uniform(-np.pi, np.pi, n)) * rng.uniform(0.05, 4.0, n)[:, None]
    return points, theta


def test_kannala_brandt_is_opencv_fisheye():
    camera = made("kannala_brandt")
    points, _ = everywhere(camera, np.random.default_rng(0), to=np.deg2rad(88))
    (fx, skew), (_, fy) = camera.affine
    K = np.array([[fx, 0, camera.centre[0]], [0, fy, camera.centre[1]], [0, 0, 1.0]])
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), K, np.array(KB), alpha=skew / fx
    )
    pixels, _ = camera.project(points)
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-8)


def test_equidistant_is_opencv_fisheye_without_distortion():
    camera = made("equidistant")
    points, _ = everywhere(camera, np.random.default_rng(1), to=np.deg2rad(88))
    K = np.array([[400.0, 0, 639.5], [0, 400.0, 511.5], [0, 0, 1.0]])
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), K, np.zeros(4)
    )
    np.testing.assert_allclose(camera.project(points)[0], expected[:, 0], atol=1e-8)


def test_ocam_rays_follow_the_polynomial_in_ocamcalib_axes():
    camera, rng = made("ocam"), np.random.default_rng(2)
    pixels = rng.uniform(0, 871, (3000, 2))
    (_, e), (d, c) = camera.affine
    row_column = pixels[:, ::-1] - np.array(camera.centre)[::-1]
    x, y = np.linalg.solve(np.array([[c, d], [e, 1.0]]), row_column.T)  # OCamCalib's cam2world
    z = np.polynomial.polynomial.polyval(np.hypot(x, y), OCAM)
    expected = np.stack([y, x, -z], -1)  # to the OpenCV frame
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    rays, valid = camera.ray(pixels)
    assert valid.mean() > 0.9
    assert np.arccos(np.clip((rays * expected).sum(-1), -1, 1))[valid].max() < 1e-6


CALIBRATIONS = Path(__file__).parents[3].parent / "shared" / "calibrations"
real_lenses = sorted(CALIBRATIONS.glob("*.json"))


@pytest.mark.skipif(not real_lenses, reason="needs ../shared/calibrations")
@pytest.mark.parametrize("path", real_lenses, ids=lambda p: p.stem)
def test_real_lenses_agree_with_their_published_inverse(path):
    """Their polynomialW2C, which the camera never reads, in the authors' own projection."""
    from egocap.cameras.camera_files import load_camera

    camera, data = load_camera(path), json.loads(path.read_text())
    points, theta = everywhere(camera, np.random.default_rng(3))
    centre = data.get("image_center") or [row[2] for row in data["intrinsic"][:2]]
    rho = np.polynomial.polynomial.polyval(theta - np.pi / 2, data["polynomialW2C"])
    plane = points[:, :2] / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
    expected = plane * rho[:, None] + np.array(centre)
    error = np.linalg.norm(camera.project(points)[0] - expected, axis=1)
    assert error.max() < 0.25  # theirs leaves out `affine`, worth 0.2 px
    pixels = np.stack(
        np.meshgrid(np.arange(0, camera.width, 7), np.arange(0, camera.height, 7)), -1
    )
    rays, valid = camera.ray(pixels)
    back, again = camera.project(rays)
    assert abs(back - pixels)[valid].max() < 1e-4 and (again == valid).all()


def test_project_and_ray_undo_each_other(camera):
    rng = np.random.default_rng(4)
    points, theta = everywhere(camera, rng)
    assert np.rad2deg(theta.max()) > 100
    pixels, valid = camera.project(points)
    rays, valid_ray = camera.ray(pixels)
    np.testing.assert_array_equal(valid, valid_ray)
    directions = points / np.linalg.norm(points, axis=-1, keepdims=True)
    np.testing.assert_allclose(rays, directions, atol=1e-11)  # in the image or not


def test_the_axis_and_its_neighbourhood_are_exact(camera):
    offsets = np.array([0.0, 1e-300, 1e-170, 1e-16, 1e-12, 1e-8])
    points = np.stack([offsets, -offsets, np.ones_like(offsets)], -1) * 0.7
    pixels, J, valid = camera.project_jacobian(points)
    assert valid.all() and np.isfinite(J).all()
    np.testing.assert_allclose(pixels[:-1], np.broadcast_to(camera.centre, (5, 2)), atol=1e-8)
    np.testing.assert_allclose(J[:-1], np.broadcast_to(J[0], (5, 2, 3)), rtol=1e-8, atol=1e-8)
    rays, valid = camera.ray(np.array(camera.centre))
    assert valid and tuple(rays) == (0.0, 0.0, 1.0)


def test_what_is_not_seen_is_invalid_but_finite(camera):
    points = np.array([[0, 0, 0], [0, 0, -1], [1e-20, 0, -1.0], [0.3, 0.1, -2.0], [50.0, 0, -1]])
    pixels, J, valid = camera.project_jacobian(points)
    assert not valid[:4].any()
    assert np.isfinite(pixels).all() and np.isfinite(J).all()
    with np.errstate(invalid="ignore"):
        assert not camera.project(np.array([[np.nan, 0, 1.0], [0, np.inf, 1.0]]))[1].any()


def test_nothing_is_clamped_to_the_border():
    camera = made("equidistant")
    far = rays_at(np.deg2rad([95.0, 100.0, 110.0, 130.0, 170.0]), 0.3)
    pixels, valid = camera.project(far)
    assert (np.diff(pixels[:, 0]) > 0).all() and pixels[-1, 0] > camera.width
    assert not valid[-2:].any()


def test_jacobian_is_the_derivative(camera):
    points, _ = everywhere(camera, np.random.default_rng(5), n=500, to=2.6)
    _, J, _ = camera.project_jacobian(points)
    h = 1e-6 * np.linalg.norm(points, axis=-1)[:, None]
    for axis in range(3):
        step = h * np.eye(3)[axis]
        numeric = (camera.project(points + step)[0] - camera.project(points - step)[0]) / (2 * h)
        scale = 1.0 + abs(J).max((1, 2))[:, None]
        assert (abs(J[..., axis] - numeric) / scale).max() < 1e-5  # the slope kinks at the rim


def test_points_and_their_derivatives_come_with_the_same_pixels(camera):
    points, _ = everywhere(camera, np.random.default_rng(10), n=500, to=2.6)
    pixels, valid = camera.project(points)
    again, _, valid_again = camera.project_jacobian(points)
    np.testing.assert_allclose(again, pixels, rtol=1e-12)
    np.testing.assert_array_equal(valid_again, valid)


def test_lists_and_single_precision_are_computed_in_double(camera):
    points, _ = everywhere(camera, np.random.default_rng(11), n=50)
    points = points.astype(np.float32)
    pixels, _ = camera.project(points.astype(np.float64))
    for form in (points, points.tolist()):
        np.testing.assert_array_equal(camera.project(form)[0], pixels)
        np.testing.assert_array_equal(camera.project_jacobian(form)[0].shape, pixels.shape)
    near = pixels.astype(np.float32)
    rays, _ = camera.ray(near.astype(np.float64))
    for form in (near, near.tolist()):
        np.testing.assert_array_equal(camera.ray(form)[0], rays)


def test_torch_gives_the_same_and_autograd_the_same_jacobian(camera):
    torch = pytest.importorskip("torch")
    points, _ = everywhere(camera, np.random.default_rng(6), n=200, to=2.6)
    points = np.concatenate([points, [[0, 0, 1.0]]]).reshape(3, 67, 3)
    tensor = torch.from_numpy(points).requires_grad_()
    pixels, J, valid = camera.project_jacobian(points)
    pixels_t, J_t, valid_t = camera.project_jacobian(tensor)
    np.testing.assert_allclose(pixels_t.detach().numpy(), pixels, atol=1e-10)
    np.testing.assert_array_equal(valid_t.numpy(), valid)
    for row in range(2):
        (gradient,) = torch.autograd.grad(camera.project(tensor)[0][..., row].sum(), tensor)
        np.testing.assert_allclose(gradient.numpy(), J[..., row, :], rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(J_t.detach().numpy(), J, rtol=1e-12, atol=1e-9)


def test_torch_rays_are_differentiable_and_float32_is_close(camera):
    torch = pytest.importorskip("torch")
    pixels = np.random.default_rng(7).uniform(0, 800, (50, 2))
    rays = camera.ray(pixels)[0]
    tensor = torch.from_numpy(pixels).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: camera.ray(p)[0], tensor)
    rays_32 = camera.ray(tensor.detach().float())[0]
    assert rays_32.dtype == torch.float32
    np.testing.assert_allclose(rays_32.numpy(), rays, atol=5e-6)
    points_32 = torch.from_numpy(rays).float()
    np.testing.assert_allclose(camera.project(points_32)[0].numpy(), pixels, atol=2e-3)


def test_any_batch_shape_gives_the_same(camera):
    points, _ = everywhere(camera, np.random.default_rng(8), n=24)
    pixels = camera.project(points)[0]
    for shape in ((24,), (2, 12), (2, 3, 4), (1, 24)):
        p, v = camera.project(points.reshape(*shape, 3))
        assert p.shape == (*shape, 2) and v.shape == shape
        np.testing.assert_array_equal(p.reshape(-1, 2), pixels)
    assert camera.project(points[0])[0].shape == (2,)
    assert camera.project(points[:0])[0].shape == (0, 2)
    assert camera.ray(pixels[:0])[0].shape == (0, 3)


def test_resizing_keeps_the_image_border_and_the_field_of_view(camera):
    points, _ = everywhere(camera, np.random.default_rng(9))
    small = camera.resized(camera.width // 2, camera.height // 4)
    pixels, valid = camera.project(points)
    scaled, valid_small = small.project(points)
    np.testing.assert_allclose(scaled, (pixels + 0.5) * [0.5, 0.25] - 0.5, atol=1e-9)
    assert (valid == valid_small).mean() > 0.999  # up to rounding on the border
    again = small.resized(camera.width, camera.height)
    np.testing.assert_allclose(again.project(points)[0], pixels, atol=1e-8)


def test_resizing_by_two_averages_pixel_pairs():
    camera = made("equidistant").resized(640, 512)
    big, _ = made("equidistant").ray(np.array([100.5, 200.5]))  # between pixels 100 and 101
    np.testing.assert_allclose(camera.project(big)[0], [50.0, 100.0], atol=1e-9)


def test_dictionary_round_trip_is_exact(camera):
    again = camera_from_dict(json.loads(json.dumps(camera.to_dict())))
    assert again == camera and hash(again) == hash(camera)
    assert again != camera.resized(100, 100)


def test_dictionary_is_plain_and_leaves_out_parameters_that_are_not_there():
    assert Camera(**SMALL).to_dict() == {
        "model": "equidistant", "width": 10, "height": 8, "centre": [4.5, 3.5],
        "affine": [[3.0, 0.0], [0.0, 3.0]], "max_angle": 1.0,
    }  # fmt: skip
    assert made("kannala_brandt").to_dict()["parameters"] == list(KB)


def test_the_widest_angle_is_found_from_the_image():
    camera = Camera("equidistant", 301, 201, (150.0, 100.0), ((100.0, 0.0), (0.0, 100.0)))
    assert camera.max_angle == pytest.approx(np.hypot(150.5, 100.5) / 100.0)


@pytest.mark.parametrize(
    "change",
    [
        {"model": "pinhole"}, {"width": 0}, {"height": -3}, {"width": 10**9},
        {"centre": (np.nan, 0.0)}, {"affine": ((0.0, 0.0), (0.0, 1.0))},
        {"affine": ((-1.0, 0.0), (0.0, 1.0))}, {"max_angle": 0.0}, {"max_angle": 3.2},
        {"parameters": (np.inf,)},
    ],
)  # fmt: skip
def test_impossible_cameras_are_refused(change):
    good = {"model": "equidistant", "width": 10, "height": 10, "centre": (4.5, 4.5),
            "affine": ((3.0, 0.0), (0.0, 3.0)), "parameters": (), "max_angle": 1.0}  # fmt: skip
    Camera(**good)
    with pytest.raises(InputError):
        Camera(**(good | change))


@settings(deadline=None, max_examples=40)
@given(
    k=st.tuples(*[st.floats(0.0, 0.05)] * 4),
    focal=st.floats(50.0, 800.0),
    angle=st.floats(0.05, 3.0),
    theta=st.floats(0.0, 1.0),
    phi=st.floats(-4.0, 4.0),
)
def test_any_growing_lens_round_trips(k, focal, angle, theta, phi):
    camera = Camera(
        "kannala_brandt", 640, 512, (320.0, 250.0), ((focal, 0.0), (0.0, focal)), k, angle
    )
    ray = rays_at(theta * angle, phi)
    pixels, _ = camera.project(ray)
    np.testing.assert_allclose(camera.ray(pixels)[0], ray, atol=1e-9)


SMALL = {"model": "equidistant", "width": 10, "height": 8, "centre": (4.5, 3.5),
         "affine": ((3.0, 0.0), (0.0, 3.0)), "max_angle": 1.0}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "pinhole"}, "unknown camera model 'pinhole' "
                               "(valid: equidistant, kannala_brandt, ocam)"),
        ({"width": 0}, "image width is 0 (valid: 1 to 65536 pixels)"),
        ({"width": 10.0}, "image width is 10.0 (valid: 1 to 65536 pixels)"),
        ({"height": 65537}, "image height is 65537 (valid: 1 to 65536 pixels)"),
        ({"centre": (0.0, -1e12)}, "a camera number is not finite, or beyond 1e12"),
        ({"affine": ((1.0, np.nan), (0.0, 1.0))}, "a camera number is not finite, or beyond 1e12"),
        ({"affine": ((1.0, 0.0), (np.inf, 1.0))}, "a camera number is not finite, or beyond 1e12"),
        ({"affine": ((1.0, 2.0), (2.0, 1.0))},
         "the focal lengths or affine matrix have the determinant -3 "
         "(valid: above zero: an image neither flat nor mirrored)"),
        ({"affine": ((0.9e-9, 0.0), (0.0, 1.0))},
         "the focal lengths or affine matrix have the determinant 9e-10 "
         "(valid: above zero: an image neither flat nor mirrored)"),
        ({"max_angle": 3.15}, "half the field of view is 3.15 rad (valid: above 0, up to pi)"),
    ],
)  # fmt: skip
def test_refusals_say_what_is_wrong_and_what_is_valid(change, message):
    with pytest.raises(InputError) as error:
        Camera(**(SMALL | change))
    assert str(error.value) == message


@pytest.mark.parametrize(
    "change",
    [
        {"width": 65536}, {"width": 1, "height": 1}, {"max_angle": np.pi},
        {"affine": ((1.1e-9, 0.0), (0.0, 1.0))}, {"centre": (-0.9e12, 0.0)},
    ],
)  # fmt: skip
def test_extreme_cameras_are_still_cameras(change):
    camera = Camera(**(SMALL | change))
    assert camera == Camera(**(SMALL | change)) and camera.max_angle in (1.0, np.pi)


def test_camera_is_shown_in_a_line():
    assert repr(made("equidistant")) == "Camera(equidistant, 1280 x 1024, 229 degrees)"


@pytest.mark.parametrize("centre", [(2, 1), (2, 6), (7, 1), (7, 6)])
def test_whole_image_is_seen_without_a_stated_angle(centre):
    """The widest angle is that of the corner farthest off the axis, under any affine matrix."""
    camera = Camera("equidistant", 10, 8, centre, ((4.0, 0.7), (-0.4, 3.0)))
    corners = np.array([[-0.5, -0.5], [9.5, -0.5], [-0.5, 7.5], [9.5, 7.5]])
    rays, _ = camera.ray(corners)
    assert np.arccos(rays[:, 2]).max() == pytest.approx(camera.max_angle)


def test_image_ends_half_a_pixel_beyond_its_outermost_pixels():
    camera = Camera(**(SMALL | {"affine": ((20.0, 0.0), (0.0, 20.0))}))
    for axis, size in ((0, 10), (1, 8)):
        for end, outwards in ((-0.5, -1), (size - 0.5, 1)):
            pixel = np.array(camera.centre)
            pixel[axis] = end
            assert camera.ray(pixel)[1]
            pixel[axis] += outwards * 1e-9
            assert not camera.ray(pixel)[1]


def test_field_of_view_and_camera_centre_bound_what_is_seen():
    camera = Camera(**(SMALL | {"max_angle": 0.5}))
    for theta, seen in ((0.5, True), (0.5 + 2e-9, False)):
        ray = rays_at(theta, 0.3)
        assert camera.project(ray)[1] == camera.project_jacobian(ray)[2] == seen
        assert camera.ray(np.array(camera.centre) + [3.0 * theta, 0.0])[1] == seen
    camera = made("equidistant")
    for distance, seen in ((1e-16, False), (2e-15, True)):
        for direction in ([0.0, 0.0, 1.0], rays_at(0.4, 0.0), rays_at(0.4, 1.5)):
            point = distance * np.array(direction)
            assert camera.project(point)[1] == seen
