"""Rotations from rays of a known rigid scene, and from pictures of a rotated camera."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount
from egocap.footage.epipolar import relative_motion
from egocap.footage.head_rotation import RotationMeter, background

NOISE = 3e-4


def rays(rotvec, translation, outliers=0, seed=0, n=200, noise=1e-4):
    """Rays to points 1.5 to 6 m away before and after a motion of the rig."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 3))
    points = directions / np.linalg.norm(directions, axis=1)[:, None] * rng.uniform(1.5, 6, (n, 1))
    R = Rotation.from_rotvec(rotvec).as_matrix()
    moved = (points - translation) @ R  # R turns the rig: points turn the other way
    moved[:outliers] += rng.normal(0, 0.3, (outliers, 3))
    unit = [p / np.linalg.norm(p, axis=1)[:, None] for p in (points, moved)]
    return unit[0], unit[1] + rng.normal(0, noise, (n, 3))


@pytest.mark.parametrize("rotvec", [(0.0, 0.0, 0.0), (0.02, -0.01, 0.05), (0.0, 0.15, -0.2)])
@pytest.mark.parametrize("translation", [(0.0, 0.0, 0.0), (0.05, 0.01, 0.0), (0.0, 0.0, -0.03)])
def test_rotation_is_free_of_translation_and_outliers(rotvec, translation):
    r1, r2 = rays(np.array(rotvec), np.array(translation), outliers=50)
    R = relative_motion(r1, r2, NOISE).R
    error = Rotation.from_matrix(R @ Rotation.from_rotvec(rotvec).as_matrix()).magnitude()
    assert error < 5e-4


def test_the_motion_before_is_a_start_and_changes_nothing_where_it_is_wrong():
    first = relative_motion(*rays(np.array([0.0, 0.3, 0.0]), np.array([0.1, 0, 0]), seed=1), NOISE)
    r1, r2 = rays(np.array([0.03, 0.0, -0.02]), np.array([0.0, 0.04, 0.0]), outliers=40)
    found, alone = relative_motion(r1, r2, NOISE, first), relative_motion(r1, r2, NOISE)
    np.testing.assert_allclose(found.R, alone.R, atol=1e-5)


def looked_at(camera, R_world_camera):
    """A picture of far surroundings with random texture."""
    rng = np.random.default_rng(3)
    sphere = cv2.GaussianBlur(rng.uniform(0, 255, (512, 1024)).astype(np.float32), (0, 0), 3)
    sphere = (sphere - sphere.min()) / np.ptp(sphere) * 255
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
    ray = camera.ray(pixels.astype(float))[0] @ R_world_camera.T
    u = (np.arctan2(ray[..., 1], ray[..., 0]) / (2 * np.pi) + 0.5) * 1023
    v = np.arccos(np.clip(ray[..., 2], -1, 1)) / np.pi * 511
    grey = cv2.remap(sphere, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, 2)


def test_pictures_of_a_turning_rig():
    camera = Camera("equidistant", 320, 256, (159.5, 127.5), ((100.0, 0.0), (0.0, 100.0)))
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]  # looks forward
    meter = RotationMeter(Mount("only", camera, T))
    heads = Rotation.from_rotvec([[0, 0, 0], [0.01, 0.02, -0.03], [0.015, 0.05, -0.09]])
    turns = [meter.add(looked_at(camera, head.as_matrix() @ T[:3, :3])) for head in heads]
    np.testing.assert_array_equal(turns[0], 0.0)
    expected = (heads[:-1].inv() * heads[1:]).as_rotvec()
    np.testing.assert_allclose(turns[1:], expected, atol=1.5e-3)


def test_the_wearers_side_of_the_picture_is_left_out():
    camera = Camera("equidistant", 64, 48, (31.5, 23.5), ((20.0, 0.0), (0.0, 20.0)))
    down = np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])  # the camera looks at the feet
    seen, rays_head = background(camera, down)
    assert not seen[24, 32] and seen.any()
    assert rays_head[24, 32, 2] < -0.99
