"""R-hat and effective draws against ArviZ's numbers and against chains of known correlation."""

import numpy as np
import pytest

from egocap.posterior.convergence import (
    bulk_effective,
    effective_draws,
    examine,
    rank_rhat,
    tail_effective,
)


def chains():
    """Correlated with one walker off, without moments, and alternating."""
    rng = np.random.default_rng(12)
    correlated, noise = np.zeros((300, 6)), rng.standard_normal((300, 6))
    for i in range(1, 300):
        correlated[i] = 0.7 * correlated[i - 1] + noise[i]
    correlated[:, 5] += 0.5
    cauchy = rng.standard_cauchy((300, 6))
    signs = np.where(np.arange(300)[:, None] % 2, 1, -1)
    return correlated, cauchy, signs * np.abs(rng.standard_normal((300, 6)))


BY_ARVIZ = (  # az.rhat, az.ess(method="bulk"), az.ess(method="tail"), chains first
    (1.0117918668856043, 351.6766760692717, 512.6852685718333),
    (0.9994391339037941, 1922.647354775139, 1933.0004456717775),
    (1.0019973878569848, 4252.113822545493, 1760.6134449081512),
)


@pytest.mark.parametrize("which", range(3))
def test_agrees_with_arviz(which):
    x = chains()[which]
    found = rank_rhat(x), bulk_effective(x), tail_effective(x)
    np.testing.assert_allclose(found, BY_ARVIZ[which], rtol=1e-6)


def test_effective_draws_of_a_correlated_chain_are_those_of_theory():
    """An AR(1) chain's autocorrelation time is (1 + a) / (1 - a)."""
    rng, a = np.random.default_rng(3), 0.8
    x = np.zeros((20_000, 4))
    for i in range(1, len(x)):
        x[i] = a * x[i - 1] + rng.standard_normal(4)
    assert effective_draws(x) == pytest.approx(x.size * (1 - a) / (1 + a), rel=0.1)


def test_walkers_that_disagree_are_found_out():
    rng = np.random.default_rng(0)
    chain = rng.standard_normal((400, 8, 2))
    assert not examine(chain).failure(("a", "b"), 400.0)
    chain[:, :4, 1] += 0.5
    health = examine(chain)
    assert health.rhat[0] < 1.01 < health.rhat[1]
    assert "disagree about b" in health.failure(("a", "b"), 10.0)


def test_walkers_of_different_width_are_found_out():
    """Their means agree: only the ranks of distances tell."""
    chain = np.random.default_rng(0).standard_normal((400, 8, 1))
    chain[:, :4] *= 3.0
    assert examine(chain).rhat[0] > 1.05


def test_walkers_that_never_move_have_no_effective_draws():
    health = examine(np.tile(np.arange(4.0)[:, None], (100, 1, 1)))
    assert np.isinf(health.rhat[0]) and health.effective[0] == 0.0
    assert "not converged" in health.failure(("a",), 400.0)
