"""Detections become rays of the right accuracy."""

import numpy as np
import pytest

from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import angular_residual
from egocap.pose.observations import observe, tangent_basis


def test_rays_pass_through_the_joints(motion):
    found = motion.detect("simulated:0")
    seen = observe(found, motion.rig, motion.person, TrackerConfig())
    residual = angular_residual(
        motion.joints[:, None], seen.centres[:, None], seen.rays, seen.whiten
    )
    assert found.valid.mean() > 0.9
    assert np.array_equal(seen.weights > 0, found.valid)
    assert np.abs(residual[found.valid]).max() < 1e-6


def test_residuals_of_noisy_detections_are_standard_normal(motion):
    found = motion.detect("simulated:2")
    config = TrackerConfig(model_error_m=0.0, pixel_floor=0.1)
    seen = observe(found, motion.rig, motion.person, config)
    residual = angular_residual(
        motion.joints[:, None], seen.centres[:, None], seen.rays, seen.whiten
    )[found.valid]
    assert residual.std() == pytest.approx(1.0, rel=0.03)
    assert np.abs(residual.mean(0)).max() < 0.05
    assert np.mean(np.sum(residual**2, -1)) == pytest.approx(2.0, rel=0.05)


def test_model_error_and_floor_widen(motion):
    exact = motion.detect("simulated:0")
    tight = observe(exact, motion.rig, motion.person, TrackerConfig(model_error_m=0.0))
    wide = observe(exact, motion.rig, motion.person, TrackerConfig(model_error_m=0.02))
    both = exact.valid
    assert (np.linalg.norm(wide.whiten[both], axis=(-1, -2))
            < np.linalg.norm(tight.whiten[both], axis=(-1, -2))).all()  # fmt: skip
    assert np.isfinite(tight.whiten).all()


def test_missing_values_never_enter(motion):
    found = motion.detect("simulated:2", hidden=0.5)
    seen = observe(found, motion.rig, motion.person, TrackerConfig())
    assert np.isnan(found.points).any()
    assert np.isfinite(seen.rays).all() and np.isfinite(seen.whiten).all()
    assert (seen.weights[~found.valid] == 0).all()


def test_pixels_off_the_image_count_as_missing(motion):
    found = motion.detect("simulated:0")
    off = Detections(
        found.times, np.full_like(found.points, -900.0), found.sigma, found.confidence,
        np.ones_like(found.valid), "test",
    )  # fmt: skip
    seen = observe(off, motion.rig, motion.person, TrackerConfig())
    assert (seen.weights == 0).all() and np.isfinite(seen.whiten).all()


def test_reversed_twice_is_the_same(motion):
    seen = observe(motion.detect("simulated:1"), motion.rig, motion.person, TrackerConfig())
    again = seen.reversed.reversed
    assert np.allclose(again.times, seen.times) and np.array_equal(again.rays, seen.rays)
    assert (np.diff(seen.reversed.times) > 0).all()


def test_views_must_match_the_rig(motion):
    found = motion.detect("simulated:1")
    one = Detections(
        found.times, found.points[:, :1], found.sigma[:, :1], found.confidence[:, :1],
        found.valid[:, :1], "test",
    )  # fmt: skip
    with pytest.raises(InputError, match="views"):
        observe(one, motion.rig, motion.person, TrackerConfig())


def test_tangent_basis_is_orthonormal():
    rays = np.random.default_rng(0).normal(size=(100, 3))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    basis = np.concatenate([tangent_basis(rays), rays[:, None]], axis=1)
    assert np.allclose(basis @ np.swapaxes(basis, -1, -2), np.eye(3), atol=1e-12)


def test_whiteners_against_dense_algebra(motion):
    """The inverse covariance across a ray: of the pixels' error, and of the skeleton's."""
    found, config = motion.detect("simulated:2,spread=0.5"), TrackerConfig(model_error_m=0.02)
    seen = observe(found, motion.rig, motion.person, config)
    for v, mount in enumerate(motion.rig.mounts):
        there = found.valid[:, v]
        camera, T = mount.camera, mount.T_head_camera
        rays, _ = camera.ray(found.points[:, v][there])
        tangent = tangent_basis(rays)
        _, J, _ = camera.project_jacobian(rays)
        to_angle = np.linalg.inv(J @ np.swapaxes(tangent, -1, -2))
        sigma = np.maximum(found.sigma[:, v], 0.5)[there]
        distance = np.linalg.norm(motion.person.rest_joints - T[:3, 3], axis=1)
        own = np.broadcast_to(0.02 / distance, there.shape)[there]
        covariance = sigma[:, None, None] ** 2 * to_angle @ np.swapaxes(to_angle, -1, -2)
        covariance = covariance + own[:, None, None] ** 2 * np.eye(2)
        across = tangent @ T[:3, :3].T
        expected = np.swapaxes(across, -1, -2) @ np.linalg.inv(covariance) @ across
        W = seen.whiten[:, v][there]
        np.testing.assert_allclose(np.swapaxes(W, -1, -2) @ W, expected, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(seen.rays[:, v][there], rays @ T[:3, :3].T, atol=1e-12)
