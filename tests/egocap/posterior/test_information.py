"""Bounds against Monte Carlo, brute-force inverses and the log posterior's own curvature."""

import numpy as np
import pytest

from egocap.body.skeleton import AGILITY, LIMITS, forward, jacobian
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import acceleration_stencil, limit_energy, posture_energy
from egocap.pose.pose_prior import load_posture
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.information import (
    Noise,
    _pairs,
    fisher_information,
    image_sensitivity,
    joint_bound,
    joint_covariance,
    lasting_information,
    place_information,
    prior_information,
    rms_mm,
    smoothed_bound,
    smoothed_covariance,
)
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.synthetic_pose import draw_detections, draw_noise, draw_poses


def test_information_is_the_curvature_of_the_log_likelihood(rig, person):
    """Gaussian errors: minus the Gauss-Newton Hessian without the prior, exactly."""
    config = PosteriorConfig(degrees=np.inf, model_error_m=0.0)
    rng = np.random.default_rng(0)
    pose, seen = 0.3 * draw_poses(1, config, rng), rng.random((1, 2, 18)) < 0.8
    found = draw_detections(pose, seen, rig, person, 2.0, config, rng)
    _, _, H = make_log_posterior(found, 0, rig, person, config).derivatives(pose[0])
    information = fisher_information(pose, person, rig, seen, Noise(2.0))
    np.testing.assert_allclose(information[0], H - load_posture().precision, rtol=1e-6, atol=1e-3)


def test_sensitivity_is_the_change_of_the_image_points(rig, person):
    rng = np.random.default_rng(3)
    pose = 0.3 * draw_poses(2, PosteriorConfig(), rng)
    seen = rng.random((2, 2, 18)) < 0.8
    found = image_sensitivity(pose, person, rig, seen, Noise(3.0))
    width = rig.cameras[0].width
    for d in (0, 4, 20, 33):
        step = 1e-6 * (np.arange(37) == d)
        after, _ = rig.project(forward(person, pose + step))
        before, _ = rig.project(forward(person, pose - step))
        moved = np.moveaxis(after - before, 0, 1) / 2e-6 / (3.0 * width / 640)
        expected = np.where(seen[..., None], moved, 0.0)
        np.testing.assert_allclose(found[..., d], expected, rtol=1e-4, atol=1e-3)


def test_detections_inform_by_their_own_spreads(rig, person):
    """As by one noise where all spreads are its; a joint of twice the spread by a quarter."""
    pose, seen = load_posture().mean[None], np.ones((1, 2, 18), bool)
    joints, width = forward(person, pose), rig.cameras[0].width
    spreads = np.full(seen.shape, 2.0 * width / 640)
    alike = place_information(joints, rig, seen, Noise(2.0))
    np.testing.assert_allclose(place_information(joints, rig, seen, Noise(7.0), spreads), alike)
    spreads[..., 4] *= 2
    own = place_information(joints, rig, seen, Noise(2.0), spreads)
    np.testing.assert_allclose(own[:, 4], alike[:, 4] / 4)
    np.testing.assert_allclose(own[:, 5], alike[:, 5])
    seen[0, 1, 5], spreads[0, 1, 5] = False, np.nan  # what was not made may hold anything
    assert np.isfinite(place_information(joints, rig, seen, Noise(2.0), spreads)).all()


def test_motion_lowers_the_bound_of_each_frame(rig, person):
    poses, times = np.repeat(load_posture().mean[None], 5, 0), np.arange(5) / 30
    seen, config = np.ones((5, 2, 18), bool), TrackerConfig()
    information = fisher_information(poses, person, rig, seen, Noise(2.0))
    alone = np.linalg.inv(information + prior_information(poses, config.lambda_posture))
    alone = rms_mm(joint_covariance(poses, person, alone))
    assert (smoothed_bound(poses, person, times, information, config)[:, 1:] < alone[:, 1:]).all()


def test_student_t_information_is_the_variance_of_the_score():
    rng = np.random.default_rng(0)
    for degrees in (4.0, 8.0):
        e = draw_noise((400_000,), degrees, rng)
        weight = (degrees + 2.0) / (degrees - 2.0 + np.sum(e * e, axis=1))
        score = weight[:, None] * e
        np.testing.assert_allclose(score.var(0), Noise(1.0, degrees).gain, rtol=0.02)


def test_a_triangulated_joint_scatters_as_bounded(rig, person):
    """Least squares on one joint's pixels in two views, many noises: the bound is reached."""
    joints = forward(person, load_posture().mean[None])
    seen = np.ones((1, 2, 18), bool)
    bound = np.linalg.inv(place_information(joints, rig, seen, Noise(1.0))[0])
    label, count = 4, 4000
    X = joints[0, label]
    pixels, _, _ = rig.project_jacobian(X)
    noisy = pixels[:, None] + np.random.default_rng(1).standard_normal((2, count, 2))
    at = np.repeat(X[None], count, axis=0)
    for _ in range(3):
        now, J, _ = rig.project_jacobian(at)
        rows = np.moveaxis(J, 0, 1).reshape(count, 4, 3)
        residual = np.moveaxis(noisy - now, 0, 1).reshape(count, 4, 1)
        at = at + (np.linalg.pinv(rows) @ residual)[..., 0]
    scatter = np.cov((at - X).T)
    np.testing.assert_allclose(scatter, bound[label], rtol=0.1, atol=0.05 * bound[label].max())


def test_maximum_likelihood_pose_scatters_as_bounded(rig, person):
    """37 angles, prior included, 300 noises: mean squared joint errors within their own error."""
    config = PosteriorConfig(degrees=np.inf, model_error_m=0.0)
    rng = np.random.default_rng(2)
    count = 300
    pose = np.repeat(0.5 * load_posture().mean[None], count, axis=0)
    seen = np.ones((count, 2, 18), bool)
    found = draw_detections(pose, seen, rig, person, 1.0, config, rng)
    information = fisher_information(pose[:1], person, rig, seen[:1], Noise(1.0))
    posterior = np.linalg.inv(information + prior_information(pose[:1]))
    truth = forward(person, pose[:1])
    estimates = []
    for frame in range(count):
        density = make_log_posterior(found, frame, rig, person, config)
        theta = pose[0]
        for _ in range(4):
            _, g, H = density.derivatives(theta)
            theta = theta + np.linalg.solve(H, g)
        estimates.append(theta)
    scatter = forward(person, np.array(estimates)) - truth
    # About its own mean, a penalised estimator scatters by P F P with P the posterior covariance.
    spread = posterior @ information @ posterior
    expected = rms_mm(joint_covariance(pose[:1], person, spread))[0, 1:]
    found_mm = 1e3 * np.sqrt(np.sum(scatter.var(0), axis=-1))[1:]
    np.testing.assert_allclose(found_mm, expected, rtol=0.15)


def test_what_nothing_sees_has_no_bound(rig, person):
    pose, seen = load_posture().mean[None], np.ones((1, 2, 18), bool)
    seen[:, :, 12:14] = False  # left ankle and foot
    information = fisher_information(pose, person, rig, seen, Noise())
    _, known = joint_bound(pose, person, information)
    assert not known[0, 13] and not known[0, 12]
    assert known[0, [3, 4, 7, 8, 11, 15, 16]].all()
    prior = information + prior_information(pose)
    covariance, known = joint_bound(pose, person, prior)
    assert known.all()
    assert rms_mm(covariance)[0, 13] > 3 * rms_mm(covariance)[0, 17]


def blocks_of_inverse(whole, times, acceleration=1.0):
    """Each frame's covariance, all written out: information (37 T, 37 T) and accelerations."""
    frames, stencil, total = len(times), acceleration_stencil(times), whole.copy()
    for t in range(frames - 2):
        row = np.zeros((37, frames * 37))
        for k in range(3):
            row[np.arange(37), 37 * (t + k) + np.arange(37)] = stencil[t, k] / (
                acceleration * AGILITY
            )
        total += row.T @ row
    inverse = np.linalg.inv(total)
    return [inverse[37 * t : 37 * t + 37, 37 * t : 37 * t + 37] for t in range(frames)]


@pytest.mark.parametrize("frames", [1, 2, 5, 6])
def test_smoothed_covariance_is_the_whole_inverse(rig, person, frames):
    config = PosteriorConfig(model_error_m=0.0)
    rng = np.random.default_rng(frames)
    poses = draw_poses(frames, config, rng)
    seen = rng.random((frames, 2, 18)) < 0.5
    information = fisher_information(poses, person, rig, seen, Noise()) + prior_information(
        poses, 0.03
    )
    times = np.cumsum(rng.uniform(0.02, 0.05, frames))
    whole = np.zeros((frames * 37, frames * 37))
    for t in range(frames):
        whole[37 * t : 37 * t + 37, 37 * t : 37 * t + 37] = information[t]
    got = smoothed_covariance(information, times)
    np.testing.assert_allclose(got, blocks_of_inverse(whole, times), rtol=1e-6, atol=1e-9)
    diagonal, _ = _pairs(information, acceleration_stencil(times), AGILITY)
    np.testing.assert_allclose(diagonal, np.swapaxes(diagonal, 1, 2), rtol=1e-9)


@pytest.mark.parametrize("frames", [1, 2, 5, 6])
def test_lasting_errors_against_their_whole_covariance(rig, person, frames):
    """Information and bound of errors with an exponential memory, written out and inverted."""
    rng = np.random.default_rng(frames)
    poses, rho = draw_poses(frames, PosteriorConfig(), rng), 0.7
    seen = np.ones((frames, 2, 18), bool)
    seen[1:3, :, 4:9] = False  # these errors begin anew in the fourth frame
    spreads = rng.uniform(1.0, 6.0, seen.shape)
    joints, J = jacobian(person, poses)
    _, by_place, _ = rig.project_jacobian(joints)
    whole = np.zeros((frames * 37, frames * 37))
    for v in range(2):
        for label in range(18):
            there = np.flatnonzero(seen[:, v, label])
            runs = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
            for run in runs:
                memory = rho ** np.abs(np.subtract.outer(run, run))
                A = np.zeros((2 * len(run), frames * 37))
                for i, t in enumerate(run):
                    A[2 * i : 2 * i + 2, 37 * t : 37 * t + 37] = (
                        by_place[v, t, label] @ J[t, label] / spreads[t, v, label]
                    )
                whole += A.T @ np.linalg.solve(np.kron(memory, np.eye(2)), A)
    noise = Noise(correlation=rho)
    own, between = lasting_information(poses, person, rig, seen, noise, spreads)
    for t in range(frames):
        np.testing.assert_allclose(
            own[t], whole[37 * t : 37 * t + 37, 37 * t : 37 * t + 37], rtol=1e-6, atol=1e-4
        )
    for t in range(frames - 1):
        np.testing.assert_allclose(
            between[t], whole[37 * t : 37 * t + 37, 37 * t + 37 : 37 * t + 74], rtol=1e-6, atol=1e-4
        )
    times, prior = np.arange(frames) / 30, prior_information(poses, 0.03)
    got = smoothed_covariance(own + prior, times, between=between)
    for t in range(frames):
        whole[37 * t : 37 * t + 37, 37 * t : 37 * t + 37] += prior[t]
    np.testing.assert_allclose(got, blocks_of_inverse(whole, times), rtol=1e-5, atol=1e-9)


def test_errors_without_memory_tell_what_single_frames_do(rig, person):
    poses = draw_poses(3, PosteriorConfig(), np.random.default_rng(0))
    seen = np.ones((3, 2, 18), bool)
    own, between = lasting_information(poses, person, rig, seen, Noise(2.0))
    np.testing.assert_allclose(own, fisher_information(poses, person, rig, seen, Noise(2.0)))
    assert not between.any()


def test_bad_input_is_refused(rig, person):
    information = np.repeat(np.eye(37)[None], 2, axis=0)
    for times in ([0.0, 0.0], [0.0, 0.1, 0.2]):
        with pytest.raises(InputError, match=r"^the times do not increase from frame to frame$"):
            smoothed_covariance(information, np.array(times))
    with pytest.raises(InputError) as error:
        smoothed_covariance(0.0 * information, np.array([0.0, 0.1]))
    assert str(error.value) == (
        "nothing fixes the motion: some angles are unknown in every frame "
        "(valid: a prior, or more detections)"
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"sigma": 0.0}, "detections with sigma 0.0 (valid: 0.001 to 1e6 px)"),
        ({"sigma": 1e6 + 0.5}, "detections with sigma 1000000.5 (valid: 0.001 to 1e6 px)"),
        ({"degrees": 2.0}, "degrees = 2.0 (valid: above 2, inf for Gaussian errors)"),
        ({"degrees": np.nan}, "degrees = nan (valid: above 2, inf for Gaussian errors)"),
        ({"model_error_m": -0.1}, "model_error_m = -0.1 (valid: from 0)"),
        ({"model_error_m": np.inf}, "model_error_m = inf (valid: from 0)"),
        ({"correlation": 1.0}, "correlation = 1.0 (valid: 0 to below 1)"),
        ({"correlation": -0.1}, "correlation = -0.1 (valid: 0 to below 1)"),
    ],
)
def test_impossible_noise_is_refused(values, message):
    with pytest.raises(InputError) as error:
        Noise(**values)
    assert str(error.value) == message


def test_noise_at_its_limits_is_accepted():
    assert Noise(1e-3).sigma == 1e-3 and Noise(1e6).sigma == 1e6
    assert Noise(degrees=2.5).gain == pytest.approx(4.5 / 6.5 * 2.5 / 0.5)


def test_model_error_adds_its_variance_to_what_one_view_sees(rig, person):
    """Across the ray, that is; along it, one view knows nothing with or without."""
    joints, seen = forward(person, load_posture().mean[None]), np.zeros((1, 2, 18), bool)
    seen[:, 0] = True
    exact = place_information(joints, rig, seen, Noise(2.0))[0]
    scattered = place_information(joints, rig, seen, Noise(2.0, model_error_m=0.03))[0]
    for label in range(1, 18):
        values, axes = np.linalg.eigh(exact[label])
        assert abs(values[0]) < 1e-9 * values[2]
        across = axes[:, 1:] @ axes[:, 1:].T
        expected = np.linalg.pinv(exact[label], 1e-9, hermitian=True) + 0.03**2 * across
        found = np.linalg.pinv(scattered[label], 1e-9, hermitian=True)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def test_sensitivities_add_up_to_the_information(rig, person):
    """Also by the detections' own spreads, to which a sensitivity is inverse."""
    rng = np.random.default_rng(4)
    pose, seen = 0.3 * draw_poses(2, PosteriorConfig(), rng), rng.random((2, 2, 18)) < 0.8
    spreads, noise = rng.uniform(1.0, 6.0, seen.shape), Noise(2.0, degrees=5.0)
    by_spread = image_sensitivity(pose, person, rig, seen, noise, spreads)
    stated = 2.0 * rig.cameras[0].width / 640
    by_noise = image_sensitivity(pose, person, rig, seen, noise)
    np.testing.assert_allclose(by_spread * spreads[..., None, None], by_noise * stated)
    for W, given in ((by_spread, spreads), (by_noise, None)):
        total = np.einsum("bvlpi,bvlpj->bij", W, W)
        information = fisher_information(pose, person, rig, seen, noise, given)
        np.testing.assert_allclose(information, total, rtol=1e-9, atol=1e-6)


def test_prior_information_is_the_curvature_of_the_prior_energy():
    """By second differences of the posture's and limits' energies; at a limit there is no wall."""
    posture, step = load_posture(), 1e-3
    pose = LIMITS.mean(1)
    pose[[2, 11]] = LIMITS[[2, 11], 1] + 0.1
    pose[30] = LIMITS[30, 0] - 0.1

    def energy(angles):
        return posture_energy(angles, posture, 0.7) + limit_energy(angles, 40.0)

    nudges = step * np.eye(37)
    curvature = [(energy(pose + d) - 2 * energy(pose) + energy(pose - d)) / step**2 for d in nudges]
    (information,) = prior_information(pose[None], 0.7, 40.0)
    np.testing.assert_allclose(np.diag(information), curvature, rtol=1e-5)
    np.testing.assert_allclose(information[2, 30], 0.7 * posture.precision[2, 30])
    without = prior_information(np.stack([pose, LIMITS[:, 0], LIMITS[:, 1]]))
    np.testing.assert_array_equal(without, np.repeat(posture.precision[None], 3, axis=0))
    for at in LIMITS.T:
        np.testing.assert_array_equal(prior_information(at[None], 1.0, 40.0)[0], posture.precision)


def test_bound_of_a_wholly_known_pose_is_its_inverse_information(rig, person):
    """In any unit of information: a thousand million times less leaves the same joints known."""
    pose, seen = load_posture().mean[None], np.ones((1, 2, 18), bool)
    information = fisher_information(pose, person, rig, seen, Noise()) + prior_information(pose)
    expected = joint_covariance(pose, person, np.linalg.inv(information))
    for scale in (1.0, 1e-12):
        covariance, known = joint_bound(pose, person, scale * information)
        assert known.all()
        np.testing.assert_allclose(scale * covariance, expected, rtol=1e-6, atol=1e-12)


def test_without_information_no_joint_but_the_root_has_a_bound(person):
    pose = load_posture().mean[None]
    covariance, known = joint_bound(pose, person, np.zeros((1, 37, 37)))
    assert np.isfinite(covariance).all()
    assert not known[0, 2:].any()


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (2, 2, 2)])
def test_root_mean_square_of_a_covariance_in_millimetres(batch):
    covariance = np.broadcast_to(np.diag([4e-6, 4e-6, 1e-6]), (*batch, 3, 3))
    np.testing.assert_allclose(rms_mm(covariance), np.full(batch, 3.0))


def test_smoothed_bound_is_of_the_trackers_priors(rig, person):
    """Against the whole inverse: its posture weight, its accelerations, lasting errors."""
    rng, frames = np.random.default_rng(5), 4
    config = TrackerConfig(lambda_posture=0.05, acceleration_sigma=2.0)
    poses, times = draw_poses(frames, PosteriorConfig(), rng), np.arange(frames) / 30
    seen = np.ones((frames, 2, 18), bool)
    noise = Noise(correlation=0.6)
    own, between = lasting_information(poses, person, rig, seen, noise)
    whole = np.zeros((frames, 37, frames, 37))
    for t in range(frames):
        whole[t, :, t] = own[t] + 0.05 * load_posture().precision
    for t in range(frames - 1):
        whole[t, :, t + 1], whole[t + 1, :, t] = between[t], between[t].T
    blocks = blocks_of_inverse(whole.reshape(frames * 37, -1), times, 2.0)
    _, J = jacobian(person, poses)
    expected = 1e3 * np.sqrt(np.einsum("tlci,tij,tlcj->tl", J, np.array(blocks), J))
    found = smoothed_bound(poses, person, times, own, config, between)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    for t in range(frames - 1):
        whole[t, :, t + 1], whole[t + 1, :, t] = 0.0, 0.0
    blocks = blocks_of_inverse(whole.reshape(frames * 37, -1), times, 2.0)
    expected = 1e3 * np.sqrt(np.einsum("tlci,tij,tlcj->tl", J, np.array(blocks), J))
    found = smoothed_bound(poses, person, times, own, config)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
