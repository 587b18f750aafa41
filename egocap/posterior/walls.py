"""The Gaussian nearest to a posterior whose angles are held by walls: expectation propagation.

At a mode that leans on a limit, the curvature is the wall's, many times narrower than the slope
that falls away inside it. A Gaussian of that curvature is a bad proposal: it never leaves the wall.
Here the smooth part (detections, posture) is Gaussian about the mode, every angle's limits are a
factor of their own, and factors become Gaussians whose product has the right mean and variance
along every angle.

Source: Minka 2001, "Expectation propagation for approximate Bayesian inference"; Cunningham, Hennig
& Lacoste-Julien 2011, "Gaussian probabilities and expectation propagation".
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

SWEEPS, DAMPING = 40, 0.6
_NODES = np.linspace(-7.0, 7.0, 281)
"""Of the quadrature along an angle, in standard deviations of what the others say."""


def between_walls(
    theta: Float[Array, "N"],
    gradient: Float[Array, "N"],
    H: Float[Array, "N N"],
    limits: Float[Array, "D 2"],
    weight: float,
) -> tuple[Float[Array, "N"], Float[Array, "N N"]]:
    """Mean and covariance, given log density's gradient and minus its Hessian at a point theta.

    The first D parameters have the log factors -weight * (distance beyond limits)^2, which both
    derivatives hold where theta is beyond.
    """
    dofs = np.arange(len(limits))
    edge = np.clip(theta[dofs], limits[:, 0], limits[:, 1])
    beyond = theta[dofs] != edge
    smooth = H.copy()
    smooth[dofs, dofs] -= 2.0 * weight * beyond
    slope = gradient.copy()
    slope[dofs] += 2.0 * weight * (theta[dofs] - edge)
    pull = smooth @ theta + slope  # of the Gaussian exp(-x S x / 2 + pull x)
    stiffness, push = np.zeros(len(theta)), np.zeros(len(theta))
    for _ in range(SWEEPS):
        covariance = np.linalg.inv(smooth + np.diag(stiffness))
        mean = covariance @ (pull + push)
        inverse = 1.0 / np.diag(covariance)[dofs]
        others = inverse - stiffness[dofs]  # precision along the angle without its own walls
        middle = (inverse * mean[dofs] - push[dofs]) / others
        m, v = _moments(middle, 1.0 / np.sqrt(others), limits, weight)
        stiffness[dofs] += DAMPING * (np.maximum(1.0 / v - others, 0.0) - stiffness[dofs])
        push[dofs] += DAMPING * (m / v - middle * others - push[dofs])
    covariance = np.linalg.inv(smooth + np.diag(stiffness))
    return covariance @ (pull + push), 0.5 * (covariance + covariance.T)


def _moments(
    middle: Float[Array, "D"], spread: Float[Array, "D"], limits: Float[Array, "D 2"], weight: float
) -> tuple[Float[Array, "D"], Float[Array, "D"]]:
    """Mean and variance of Gaussians times their walls. The quadrature covers both the Gaussian
    and, where that lies far behind a wall, the edge to which it is pushed."""
    edge = np.clip(middle, limits[:, 0], limits[:, 1])
    stiff = 2.0 * weight * spread**2
    pushed = (middle + stiff * edge) / (1.0 + stiff)  # mode of Gaussian and wall together
    narrow = np.where(edge == middle, spread, spread / np.sqrt(1.0 + stiff))
    low = np.minimum(middle - 7.0 * spread, pushed - 7.0 * narrow)
    high = np.maximum(middle + 7.0 * spread, pushed + 7.0 * narrow)
    # Half of the nodes about the mode, half over everything: sorted, they make one trapezium rule.
    share = (_NODES - _NODES[0]) / (_NODES[-1] - _NODES[0])
    x = np.concatenate(
        [low[:, None] + (high - low)[:, None] * share, pushed[:, None] + narrow[:, None] * _NODES],
        axis=1,
    )
    x.sort(axis=1)
    over = np.maximum(x - limits[:, 1:], 0.0) + np.maximum(limits[:, :1] - x, 0.0)
    log = -0.5 * ((x - middle[:, None]) / spread[:, None]) ** 2 - weight * over**2
    density = np.exp(log - log.max(axis=1, keepdims=True))
    total = np.trapezoid(density, x, axis=1)
    m = np.trapezoid(density * x, x, axis=1) / total
    v = np.trapezoid(density * (x - m[:, None]) ** 2, x, axis=1) / total
    return m, v
