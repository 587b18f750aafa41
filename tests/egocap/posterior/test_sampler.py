"""emcee on posteriors whose answer is known, with two modes, and after a kill."""

from dataclasses import replace

import emcee
import numpy as np
import pytest

from egocap.body.skeleton import DOF_INDEX, forward
from egocap.errors import FileError, InputError
from egocap.pose.pose_prior import load_posture
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.log_prob import LogPosterior, make_log_posterior
from egocap.posterior.moves import Crank, Hop, Mixture, Trajectory
from egocap.posterior.result import load_posterior, save_posterior
from egocap.posterior.sampler import fingerprint, sample
from egocap.posterior.synthetic_pose import draw_detections, draw_poses

CONFIG = PosteriorConfig(model_error_m=0.0)


@pytest.fixture(scope="module")
def density(rig, person):
    rng = np.random.default_rng(5)
    poses = draw_poses(1, CONFIG, rng)
    seen = np.ones((1, 2, 18), bool)
    return make_log_posterior(
        draw_detections(poses, seen, rig, person, 4.0, CONFIG, rng), 0, rig, person, CONFIG
    )


def run(log_prob, moves, start, steps, seed=0):
    random = np.random.RandomState(seed)
    state = emcee.State(np.array(start), random_state=random.get_state())
    sampler = emcee.EnsembleSampler(*start.shape, log_prob, vectorize=True, moves=moves)
    sampler.run_mcmc(state, steps)
    return sampler


def test_crank_and_hop_leave_two_unequal_modes_as_they_are():
    """Exact shares and moments of a mixture that the proposal's mixture only resembles."""
    means, scales = np.array([[-4.0, 0.0], [4.0, 1.0]]), np.array([0.5, 1.0])
    shares = np.array([0.2, 0.8])

    def log_prob(x):
        away = np.sum((x[:, None] - means) ** 2, axis=-1) / scales**2
        return np.logaddexp.reduce(np.log(shares / scales**2) - 0.5 * away, axis=1)

    rough = Mixture(means + 0.2, np.array([0.36 * np.eye(2), 0.8 * np.eye(2)]), np.ones(2))
    start = np.repeat(means, 20, axis=0) + 0.1 * np.random.default_rng(0).normal(size=(40, 2))
    few = Crank(rough, (1.0,), (1,))
    moves = [(Crank(rough, (0.4, 0.8)), 0.4), (few, 0.3), (Hop(rough), 0.3)]
    chain = run(log_prob, moves, start, 4000).get_chain(discard=200, flat=True)
    right = chain[:, 0] > 0
    assert right.mean() == pytest.approx(0.8, abs=0.02)
    np.testing.assert_allclose(chain[right].mean(0), means[1], atol=0.06)
    np.testing.assert_allclose(chain[right].std(0), 1.0, atol=0.05)
    np.testing.assert_allclose(chain[~right].std(0), 0.5, atol=0.05)


def test_crank_never_rejects_its_own_gaussian():
    covariance = np.diag(np.linspace(0.01, 4.0, 37))
    own = Mixture(np.zeros((1, 37)), covariance[None], np.ones(1))
    sampler = run(
        lambda x: -0.5 * np.sum(x * x / np.diag(covariance), axis=1),
        [(Crank(own, (0.7,)), 1.0)],
        own.draw(80, np.random.RandomState(1)),
        50,
    )
    assert np.all(sampler.acceptance_fraction == 1.0)


def test_few_directions_at_a_time_keep_a_correlated_gaussian():
    """Redrawn whole, few directions of the Gaussian's own are Gibbs sampling: no rejection."""
    root = np.tril(np.random.default_rng(4).normal(size=(6, 6))) + 2.0 * np.eye(6)
    covariance = root @ root.T
    precision = np.linalg.inv(covariance)
    own = Mixture(np.ones((1, 6)), covariance[None], np.ones(1))
    sampler = run(
        lambda x: -0.5 * np.einsum("wi,ij,wj->w", x - 1.0, precision, x - 1.0),
        [(Crank(own, (1.0,), (1, 3)), 1.0)],
        own.draw(40, np.random.RandomState(1)),
        3000,
    )
    assert np.all(sampler.acceptance_fraction == 1.0)
    found = np.cov(sampler.get_chain(discard=200, flat=True).T)
    np.testing.assert_allclose(found, covariance, atol=0.06 * np.diag(covariance).max())


def leapfrog_of(gradient):
    """The leapfrog of `hamiltonian.leapfrog` for any gradient of many walkers."""

    def leapfrog(roots, which, sizes, steps, thetas, momenta):
        root = roots[which]
        for step in range(steps.max()):
            size = np.where(step < steps, sizes, 0.0)[:, None]
            momenta += 0.5 * size * np.einsum("wij,wi->wj", root, gradient(thetas))
            thetas += size * np.einsum("wij,wj->wi", root, momenta)
            momenta += 0.5 * size * np.einsum("wij,wi->wj", root, gradient(thetas))

    return leapfrog


def test_trajectories_keep_a_mixture_that_their_metric_only_resembles():
    """Walkers start in two unequal Gaussians and stay in them; the metrics' are other ones."""
    means, scales = np.array([[-1.5, 0.0], [1.5, 0.5]]), np.array([0.5, 1.0])
    shares, rng = np.array([0.3, 0.7]), np.random.default_rng(4)

    def parts(x):
        away = np.sum((x[:, None] - means) ** 2, axis=-1) / scales**2
        return np.log(shares / scales**2) - 0.5 * away

    def gradient(x):
        share = np.exp(parts(x) - np.logaddexp.reduce(parts(x), axis=1)[:, None])
        return np.sum((share / scales**2)[..., None] * (means - x[:, None]), axis=1)

    rough = Mixture(means + 0.2, np.array([0.4 * np.eye(2), 0.8 * np.eye(2)]), np.ones(2))
    moves = [(Trajectory(rough, leapfrog_of(gradient), 0.4), 1.0)]
    which = (rng.random(2000) < shares[1]).astype(int)
    start = means[which] + scales[which, None] * rng.standard_normal((2000, 2))
    sampler = run(lambda x: np.logaddexp.reduce(parts(x), axis=1), moves, start, 60)
    flat = sampler.get_chain(discard=20, flat=True)
    assert sampler.acceptance_fraction.mean() > 0.6
    np.testing.assert_allclose(flat.mean(0), shares @ means, atol=0.07)
    second = shares @ (means**2 + scales[:, None] ** 2)
    np.testing.assert_allclose((flat**2).mean(0), second, atol=0.12)


def test_diverged_trajectory_is_rejected():
    def burst(roots, which, sizes, steps, thetas, momenta):
        thetas[::2] = np.nan

    own = Mixture(np.zeros((1, 2)), np.eye(2)[None], np.ones(1))
    start = own.draw(8, np.random.RandomState(1))
    sampler = run(lambda x: -0.5 * np.sum(x * x, axis=1), [(Trajectory(own, burst), 1.0)], start, 5)
    np.testing.assert_array_equal(sampler.get_chain()[-1], start)
    assert (sampler.acceptance_fraction[::2] == 0.0).all()


@pytest.mark.parametrize("name", ["crank", "few", "trajectory"])
def test_every_move_leaves_a_gaussian_of_37_dimensions_as_wide_as_it_is(name):
    """Walkers start in equilibrium and must stay there: the mean squared length is 37."""
    rough = Mixture(np.full((1, 37), 0.1), 0.8 * np.eye(37)[None], np.ones(1))
    moves = {
        "crank": Crank(rough, (0.3,)),
        "few": Crank(rough, (1.0,), (4, 12)),
        "trajectory": Trajectory(rough, leapfrog_of(lambda x: -x)),
    }
    start = np.random.default_rng(3).standard_normal((400, 37))
    sampler = run(lambda x: -0.5 * np.sum(x * x, axis=1), [(moves[name], 1.0)], start, 150)
    assert sampler.acceptance_fraction.mean() > 0.1
    squared = -2.0 * sampler.get_log_prob(discard=50)
    # 400 walkers of which each has about one independent value: sqrt(2 37 / 400) = 0.43.
    assert squared.mean() == pytest.approx(37.0, abs=1.5)


def test_arm_of_three_joints_agrees_with_quadrature(rig, person):
    """Shoulder's swing, elbow and wrist of one arm, the rest held: moments known by a fine grid."""
    rng = np.random.default_rng(8)
    pose = load_posture().mean[None]
    seen = np.zeros((1, 2, 18), bool)
    seen[0, 0, 4:6] = True  # wrist and hand, in one view: curved and broad
    found = draw_detections(pose, seen, rig, person, 8.0, CONFIG, rng)
    density = make_log_posterior(found, 0, rig, person, CONFIG)
    dofs = [DOF_INDEX[f"left_{n}"] for n in ("shoulder_swing", "elbow_flexion", "wrist_flexion")]

    def log_prob(x):
        theta = np.tile(pose[0], (len(x), 1))
        theta[:, dofs] = x
        return density(theta)

    axes = [np.linspace(*edges, 71) for edges in ((-1.6, 1.6), (-0.4, 2.8), (-1.7, 1.7))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    logs = log_prob(grid)
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ grid
    spread = np.sqrt(weights @ (grid - mean) ** 2)

    start = mean + 0.1 * rng.standard_normal((24, 3))
    moves = [(emcee.moves.DEMove(), 0.5), (emcee.moves.StretchMove(), 0.5)]
    chain = run(log_prob, moves, start, 6000).get_chain(discard=600)
    tau = emcee.autocorr.integrated_time(chain, tol=0)
    error = spread / np.sqrt(chain.shape[0] * chain.shape[1] / tau)
    flat = chain.reshape(-1, 3)
    assert np.all(np.abs(flat.mean(0) - mean) < 4.0 * error)
    # The error of a standard deviation is that of the mean over sqrt 2, for a Gaussian.
    np.testing.assert_allclose(flat.std(0), spread, atol=4.0 * error.max())


def test_occluded_arm_has_two_explanations_and_both_are_sampled(rig, person):
    """Wrist and hand are seen by one camera: the forearm may point towards it or away from it."""
    rng = np.random.default_rng(66)
    config = replace(CONFIG, degrees=np.inf)
    pose = draw_poses(1, config, rng)
    seen = np.ones((1, 2, 18), bool)
    seen[0, 1, 4:6] = False
    found = draw_detections(pose, seen, rig, person, 1.0, config, rng)
    result = sample(
        make_log_posterior(found, 0, rig, person, config),
        SamplerConfig(most_steps=3000, effective=100),
    )
    near, far = forward(person, result.modes[:2])[:, 4]
    assert np.linalg.norm(near - far) > 0.15
    wrist = result.joints[:, :, 4]  # (W, S, 3)
    at_near = np.linalg.norm(wrist - near, axis=-1) < np.linalg.norm(wrist - far, axis=-1)
    assert 0.02 < at_near.mean() < 0.98
    # Walkers change sides: the shares are the posterior's, not those of the start.
    changes = np.mean(at_near[:, 1:] != at_near[:, :-1])
    assert changes > 0.005
    np.testing.assert_allclose(result.mode_share[0], at_near.mean(), atol=0.05)


def test_same_seed_same_draws_and_a_kill_changes_nothing(density, tmp_path):
    config = SamplerConfig(most_steps=1000, effective=1e5, seed=4)
    whole = sample(density, config, checkpoint=tmp_path / "a.npz")
    half = replace(config, most_steps=600)
    sample(density, half, checkpoint=tmp_path / "b.npz")  # stands for a kill at step 600
    resumed = sample(density, config, checkpoint=tmp_path / "b.npz")
    np.testing.assert_array_equal(resumed.draws, whole.draws)
    np.testing.assert_array_equal(resumed.log_prob, whole.log_prob)
    assert resumed.acceptance == whole.acceptance
    with pytest.raises(FileError, match="another frame, or of other settings"):
        sample(density, replace(config, seed=5), checkpoint=tmp_path / "b.npz")


def test_chain_of_other_images_is_not_continued(density):
    parts = (density.measurement, density.rig, density.proportions, CONFIG)

    def of_images(seed, starts=None):
        images = np.random.default_rng(seed).normal(size=37)
        return fingerprint(LogPosterior(*parts, lambda a: a @ images), SamplerConfig(), starts)

    assert of_images(0) == of_images(0) != of_images(1)
    starts = np.full((1, 37), 0.1)
    assert of_images(0, starts) == of_images(0, starts) != of_images(1, starts)


def test_short_chain_admits_it_with_numbers(density, tmp_path):
    result = sample(density, SamplerConfig(most_steps=2000, effective=1e5))
    assert not result.converged
    assert "effective draws" in result.outcome and "100000 are needed" in result.outcome
    save_posterior(tmp_path / "post.npz", result)
    again = load_posterior(tmp_path / "post.npz")
    assert again.outcome == result.outcome and again.names == result.names
    np.testing.assert_array_equal(again.draws, result.draws)
    np.testing.assert_allclose(
        again.flat_joints[:5], forward(density.proportions, again.flat[:5]), atol=1e-12
    )


def test_chain_converges_to_the_limits_of_the_diagnostics(density):
    result = sample(density, SamplerConfig(seed=2))
    assert result.converged and "converged: R-hat" in result.outcome
    assert result.rhat.max() <= 1.01
    assert min(result.effective.min(), result.tail_effective.min()) >= 400


def test_too_few_walkers_are_refused():
    with pytest.raises(InputError, match=r"3 walkers.*4 or more"):
        SamplerConfig(walkers=3)


def test_damaged_checkpoint_is_refused(density, tmp_path):
    path = tmp_path / "chain.npz"
    path.write_bytes(b"PK nonsense")
    with pytest.raises(FileError, match=r"chain\.npz"):
        sample(density, SamplerConfig(), checkpoint=path)
