"""The frame in which a calibration is scored is a turn about the axis, and nothing else."""

import numpy as np

from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount
from egocap.geometry import axis_angle, inverse, rigid, transform
from egocap_eval.calibration.lenses import with_symmetric_affine


def test_pixels_of_head_points_stay():
    camera = Camera("ocam", 1280, 1024, (642.0, 517.0), ((1.0, 3e-3), (-2e-3, 0.998)),
                    (-380.0, 0.0, 8e-4, -6e-7, 9e-10))  # fmt: skip
    mount = Mount(
        "left", camera, rigid(axis_angle(np.array([0.6, 0.8, 0.0]), 0.7), [0.1, 0.2, 0.3])
    )
    found = with_symmetric_affine(mount)
    affine = np.array(found.camera.affine)
    assert np.allclose(affine, affine.T)
    points = np.random.default_rng(0).normal(size=(50, 3))
    before, after = (m.camera.project(transform(inverse(m.T_head_camera), points))[0]
                     for m in (mount, found))  # fmt: skip
    assert np.allclose(before, after, atol=1e-8)
    assert np.allclose(found.T_head_camera[:3, 2:], mount.T_head_camera[:3, 2:])
