"""The compiled log posterior against its readable form, differences, and what it must refuse."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.skeleton import forward
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.log_prob import SCALES, make_log_posterior, readable_log_posterior
from egocap.posterior.synthetic_pose import draw_detections, draw_poses


@pytest.fixture
def case(rig, person):
    config = PosteriorConfig(model_error_m=0.0)
    rng = np.random.default_rng(3)
    poses = draw_poses(3, config, rng)
    seen = rng.random((3, 2, 18)) < 0.7
    return poses, draw_detections(poses, seen, rig, person, 2.0, config, rng), rng


@pytest.mark.parametrize("degrees", [5.0, np.inf])
def test_agrees_with_readable_form(case, rig, person, degrees):
    _, found, rng = case
    config = PosteriorConfig(degrees=degrees, temperature=1.7)
    density = make_log_posterior(found, 1, rig, person, config)
    # Wide of the prior too, so that limits are exceeded and points leave the image.
    poses = draw_poses(4, config, rng) + rng.normal(0, 0.6, (4, 37))
    expected = [
        readable_log_posterior(pose, density.measurement, rig, person, config) for pose in poses
    ]
    np.testing.assert_allclose(density(poses), expected, rtol=1e-12)


@pytest.mark.parametrize("degrees", [5.0, np.inf])
def test_gradient_by_angles_scales_and_rig(case, rig, person, degrees):
    poses, found, rng = case
    config = PosteriorConfig(degrees=degrees, bone_scales=True, rig_errors=True)
    density = make_log_posterior(found, 0, rig, person, config)
    assert density.size == 37 + len(SCALES) + 12 == len(density.names)
    theta = np.concatenate([poses[0] + 0.2, rng.normal(0, 0.02, 9), rng.normal(0, 0.01, 12)])
    value, gradient, H = density.derivatives(theta)
    assert value == pytest.approx(density(theta[None])[0], rel=1e-12)
    steps = 1e-6 * np.eye(density.size)
    numeric = (density(theta + steps) - density(theta - steps)) / 2e-6
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(density.gradients(theta[None])[0], gradient, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(H, H.T, rtol=1e-9, atol=1e-6)
    assert np.linalg.eigvalsh(H)[0] > 0


def test_leapfrog_keeps_energy_and_returns_when_reversed(case, rig, person):
    poses, found, rng = case
    density = make_log_posterior(found, 0, rig, person, PosteriorConfig())
    roots = np.array([0.01 * np.eye(37), 0.02 * np.tril(np.eye(37) + 0.1)])
    which, sizes, steps = np.array([0, 1, 1]), np.array([0.02, 0.01, 0.005]), np.array([30, 60, 20])
    start = poses[:1] + 0.01 * rng.standard_normal((3, 37))
    thetas, momenta = start.copy(), rng.standard_normal((3, 37))

    def energy():
        return 0.5 * np.sum(momenta**2, axis=1) - density(thetas)

    before = energy()
    density.leapfrog(roots, which, sizes, steps, thetas, momenta)
    assert np.abs(thetas - start).max() > 0.001
    np.testing.assert_allclose(energy(), before, atol=0.1)
    momenta *= -1.0
    density.leapfrog(roots, which, sizes, steps, thetas, momenta)
    np.testing.assert_allclose(thetas, start, atol=1e-9)


def test_curvature_is_the_hessian_where_the_residuals_vanish(case, rig, person):
    poses, _, rng = case
    config = PosteriorConfig(degrees=np.inf, model_error_m=0.0)
    inside = poses[:1] * 0.2
    exact = draw_detections(inside, np.ones((1, 2, 18), bool), rig, person, 0.5, config, rng)
    pixels, _ = rig.project(forward(person, inside))
    density = make_log_posterior(
        replace(exact, points=np.moveaxis(pixels, 0, 1)), 0, rig, person, config
    )
    _, _, H = density.derivatives(inside[0])
    steps = 1e-5 * np.eye(37)
    slope = np.array([density.derivatives(pose)[1] for pose in (*inside + steps, *inside - steps)])
    numeric = -(slope[:37] - slope[37:]) / 2e-5
    np.testing.assert_allclose(H, numeric, rtol=1e-4, atol=1e-4 * np.abs(H).max())


def test_scaled_bones_move_joints(case, rig, person):
    poses, found, _ = case
    density = make_log_posterior(found, 0, rig, person, PosteriorConfig(bone_scales=True))
    theta = np.zeros((2, density.size))
    theta[:, :37] = poses[0]
    theta[1, density.names.index("scale_forearms")] = np.log(1.1)
    joints = density.joints(theta)
    np.testing.assert_allclose(joints[0], forward(person, poses[0]), atol=1e-12)
    bone = np.linalg.norm(joints[:, 4] - joints[:, 3], axis=-1)
    assert bone[1] / bone[0] == pytest.approx(1.1)
    np.testing.assert_allclose(joints[0, :4], joints[1, :4], atol=1e-12)


def test_no_detections_leave_the_prior_and_say_so(case, rig, person):
    _, found, _ = case
    nothing = replace(found, valid=np.zeros_like(found.valid))
    density = make_log_posterior(nothing, 0, rig, person)
    assert density.measurement.count == 0
    assert "the prior" in density.measurement.notes[0]


def test_missing_spread_gets_the_stated_default(case, rig, person):
    _, found, _ = case
    config = PosteriorConfig(default_sigma=3.0, model_error_m=0.0)
    without = replace(found, sigma=np.zeros_like(found.sigma))
    density = make_log_posterior(without, 0, rig, person, config)
    assert "state no spread: 3 px" in density.measurement.notes[0]
    used = density.measurement.weights > 0
    np.testing.assert_allclose(
        density.measurement.whiten[used], np.tile(np.eye(2) / 3.0, (used.sum(), 1, 1)), atol=1e-12
    )


def test_bad_input_is_refused(case, rig, person):
    _, found, _ = case
    with pytest.raises(InputError, match=r"no frame 7.*0 to 2"):
        make_log_posterior(found, 7, rig, person)
    with pytest.raises(InputError, match="degrees = 2"):
        PosteriorConfig(degrees=2.0)
    with pytest.raises(InputError, match="temperature = 0"):
        PosteriorConfig(temperature=0.0)
