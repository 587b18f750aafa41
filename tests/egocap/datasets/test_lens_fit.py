"""Fitted cameras against OpenCV's fisheye model and against the cameras that made the pixels."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap.cameras.rig_files import camera_rotation
from egocap.datasets.lens_fit import fit_camera, fit_lens
from egocap.errors import FileError
from egocap.geometry import inverse, rigid, transform

SIZE = (1280, 800)
K = np.array([[352.0, 0, 654.0], [0, 353.0, 401.0], [0, 0, 1]])
D = np.array([-0.056, -0.0038, -0.00025, -0.00012])


@pytest.fixture
def points():
    rng = np.random.default_rng(0)
    return rng.uniform([-0.6, -0.6, 0.1], [0.6, 0.6, 1.6], (800, 3))


def opencv_pixels(points):
    return cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D)[0][:, 0]


def test_a_lens_of_opencv_is_found_from_its_pixels(points):
    camera = fit_lens(points, opencv_pixels(points), SIZE, Path("labels"))
    assert np.allclose(camera.affine, K[:2, :2], atol=1e-3)
    assert np.allclose(camera.centre, K[:2, 2], atol=1e-3)
    other = np.random.default_rng(1).uniform([-0.4, -0.4, 0.4], [0.4, 0.4, 1.4], (200, 3))
    assert np.abs(camera.project(other)[0] - opencv_pixels(other)).max() < 1e-3


@pytest.mark.parametrize("angles", [(90, 0, 0), (60, 40, 90), (20, -70, 180), (100, 10, -45)])
def test_a_camera_is_found_from_pixels_and_depths(angles, points):
    truth = Camera("kannala_brandt", *SIZE, (640.0, 390.0), ((400.0, 0.0), (0.0, 401.0)), tuple(D))
    T_device_camera = rigid(camera_rotation(*angles), np.array([0.08, 0.05, -0.02]))
    device = transform(T_device_camera, points)
    pixels, _ = truth.project(points)
    camera, T_camera_device = fit_camera(device, pixels, points[:, 2], SIZE, Path("labels"))
    assert np.abs(T_camera_device - inverse(T_device_camera)).max() < 1e-5
    assert np.abs(camera.project(points)[0] - pixels).max() < 1e-3


def test_a_few_wrong_pixels_do_not_move_the_lens(points):
    pixels = opencv_pixels(points)
    wrong = pixels.copy()
    wrong[::25] += 60.0
    camera = fit_lens(points, wrong, SIZE, Path("labels"))
    kept = np.delete(np.arange(800), np.s_[::25])
    assert np.abs(camera.project(points)[0] - pixels)[kept].max() < 0.1


def test_pixels_of_no_lens_are_refused(points):
    pixels = np.random.default_rng(2).uniform(0, 800, (800, 2))[::8]
    points = points[::8]
    with pytest.raises(FileError, match="no fisheye lens fits"):
        fit_lens(points, pixels, SIZE, Path("labels"))
    with pytest.raises(FileError, match="one axis"):
        fit_camera(points, pixels, 100.0 * points[:, 2], SIZE, Path("labels"))
