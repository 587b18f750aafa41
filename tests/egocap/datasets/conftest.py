"""A short motion seen by given cameras, and the check of what a reader makes of it."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.camera_files import load_camera
from egocap.cameras.rig_files import camera_rotation
from egocap.datasets.calibration import SHIPPED
from egocap.geometry import UP, axis_angle, inverse, rigid, transform
from tests.egocap.datasets.miniature import Shot


@pytest.fixture
def shoot(motion):
    """Make a `Shot` of T frames by cameras at poses in the device's frame."""

    def make(cameras, T_device_camera, T=6):
        head = motion.joints[:: len(motion.joints) // T][:T]
        T_head_device = rigid(camera_rotation(90.0), np.array([0.25, 0.02, 0.11]))
        turns = axis_angle(UP, 0.3 * np.arange(T)) @ axis_angle(np.array([0.0, 1.0, 0.0]), 0.2)
        T_world_head = rigid(turns, np.array([[1.0 + 0.1 * t, -2.0, 1.6] for t in range(T)]))
        device = transform(inverse(T_head_device), head)
        T_camera_device = inverse(np.stack(T_device_camera))
        camera = np.stack([transform(T, device) for T in T_camera_device], 1)
        pixels = np.stack([c.project(camera[:, v])[0] for v, c in enumerate(cameras)], 1)
        world = transform(T_world_head, head)
        return Shot(camera, device, world, pixels, inverse(T_camera_device), tuple(cameras))

    return make


@pytest.fixture
def ocam():
    """A real fisheye's calibration by name, as shipped."""
    return lambda name: load_camera(SHIPPED / f"{name}.json")


@pytest.fixture
def check():
    """Compare a recording with the shot it was written from, to 0.01 mm and 0.01 px."""

    def compare(recording, shot, labels, *, pixels=True, world=True, images=True, lens_px=0.01):
        found, T = recording.labels, len(shot)
        assert len(recording) == T and found.labelled.shape == (T, 18)
        index = [LABEL_INDEX[label] for label in labels]
        expected = np.zeros((T, 18), bool)
        expected[:, index] = True
        assert np.array_equal(found.labelled, expected)
        for v, T_camera_head in enumerate(recording.rig.T_camera_head):
            camera = transform(T_camera_head, found.joints_head)
            assert np.abs(camera - shot.camera[:, v])[:, index].max() < 1e-5
        if pixels:
            assert found.in_view.any((0, 2)).all()
            apart = np.abs(found.points - shot.pixels)[found.in_view]
            assert apart.max() < 0.01 and recording.reprojection_px() < lens_px
        if world:
            back = transform(found.T_world_head, found.joints_head)
            assert np.abs(back - shot.world)[:, index].max() < 1e-5
        if images:
            for v, image in enumerate(recording.images(T - 1)):
                assert np.array_equal(image, shot.image(T - 1, v))

    return compare
