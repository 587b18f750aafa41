"""Corners as the crossing of two blurred edges, fitted to the pixels around them.

In coordinates u = (x, y) on the board, whose unit is half the side of a corner's patch,

    I = a + b.u + (c + d.u) s + e s^2,
    s = erf((x - x0) / (sqrt 2 w_x)) erf((y - y0) / (sqrt 2 w_y)).

b and d follow uneven light: a gradient along one edge would else move the other. e follows the
camera's tone curve and ink that has spread, which make the squares of one colour larger. The pixels
are those of the picture, since resampling adds errors of its own. w is the blur of the lens, as
wide in all directions of the image.

Source: Levenberg-Marquardt as in Nocedal and Wright 2006, section 10.3; the covariance of least
squares with uneven weights is the sandwich of White 1980.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import erf

_STEPS = 15
_BLUR_PX, _BLUR_SPREAD = 0.8, 0.4  # expected blur, and the standard deviation of its logarithm
_SMALL = 1e-4  # of the patch's unit: a step that ends the fit
_LEAST_NOISE = 0.3  # grey levels: that of rounding
_SHAPE, _LIGHT = 3, 7  # parameters of s: x0, y0, log of the blur; then a, b, c, d, e
_MOST_STEP = np.array([0.2, 0.2, 0.5])


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The P pixels around each of n corners; their weight is 0 where they are not used."""

    grey: Float[Array, "n P"]
    at: Float[Array, "n P 2"]  # u
    weight: Float[Array, "n P"]
    pixel: Float[Array, "n 2"]  # standard deviation of x and y for one of 1 px in the image


class _Fit(NamedTuple):
    cost: Float[Array, "n"]
    H: Float[Array, "n 10 10"]
    g: Float[Array, "n 10"]
    covariance: Float[Array, "n 2 2"]


def fit_saddles(
    seen: Surroundings, start: Float[Array, "n 2"]
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2 2"]]:
    """Corners (x0, y0) and their covariance, scaled by the residuals, in the patch's unit."""
    p = _start(seen, start)
    fit, damping = _linearised(seen, p), np.full(len(p), 1e-3)
    for _ in range(_STEPS):
        diagonal = np.diagonal(fit.H, axis1=1, axis2=2)
        damped = fit.H + (damping[:, None] * diagonal)[:, :, None] * np.eye(p.shape[1])
        step = np.linalg.solve(damped, fit.g[..., None])[..., 0]
        step[:, :_SHAPE] = np.clip(step[:, :_SHAPE], -_MOST_STEP, _MOST_STEP)
        trial = p + step
        new = _linearised(seen, trial)
        better = new.cost < fit.cost
        p = np.where(better[:, None], trial, p)
        fit = _Fit(*(np.where(better.reshape(-1, *[1] * (a.ndim - 1)), a, b)
                     for a, b in zip(new, fit, strict=True)))  # fmt: skip
        damping = np.where(better, damping / 8, damping * 8)
        if np.abs(step[:, :2]).max(initial=0.0) < _SMALL:
            break
    return p[:, :2], fit.covariance


def _start(seen: Surroundings, corner: Float[Array, "n 2"]) -> Float[Array, "n 10"]:
    """The light that fits best to corners at the starting points."""
    p = np.column_stack(
        [corner, np.full(len(corner), np.log(_BLUR_PX)), np.zeros((len(corner), 7))]
    )
    basis = _derivatives(seen, p)[1][..., _SHAPE:]
    weighted = seen.weight[..., None] * basis
    H = basis.swapaxes(1, 2) @ weighted + 1e-6 * np.eye(basis.shape[2])
    right = np.einsum("npk,np->nk", weighted, seen.grey)
    p[:, _SHAPE:] = np.linalg.solve(H, right[..., None])[..., 0]
    return p


def _linearised(seen: Surroundings, p: Float[Array, "n 10"]) -> _Fit:
    """Cost, normal equations and covariance of (x0, y0)."""
    model, J = _derivatives(seen, p)
    residual = seen.grey - model
    w = seen.weight
    weighted = w[..., None] * J
    H = weighted.swapaxes(1, 2) @ J
    H += 1e-6 * np.eye(H.shape[-1])
    g = np.einsum("npk,np->nk", weighted, residual)
    squared = (w * residual**2).sum(1)
    noise = squared / np.maximum(w.sum(1) - p.shape[1], 1.0) + _LEAST_NOISE**2
    # the prior of the blur, in units of the noise
    off = p[:, 2] - np.log(_BLUR_PX)
    pull = noise / _BLUR_SPREAD**2
    cost = squared + pull * off**2
    H[:, 2, 2] += pull
    g[:, 2] -= pull * off
    inverse = np.linalg.inv(H)[:, :2]
    meat = weighted.swapaxes(1, 2) @ weighted
    covariance = noise[:, None, None] * (inverse @ meat @ inverse.swapaxes(1, 2))
    return _Fit(cost, H, g, covariance)


def _derivatives(
    seen: Surroundings, p: Float[Array, "n 10"]
) -> tuple[Float[Array, "n P"], Float[Array, "n P 10"]]:
    """The model's grey values and their derivatives by all parameters."""
    u = seen.at
    width = (seen.pixel * np.exp(p[:, 2:3]))[:, None]
    z = (u - p[:, None, :2]) / width
    f, slope = erf(z / np.sqrt(2.0)), np.sqrt(2.0 / np.pi) * np.exp(-0.5 * z * z)
    s = f[..., 0] * f[..., 1]
    other = f[..., ::-1]
    by_corner = -slope / width * other
    by_blur = -(slope * z * other).sum(-1)
    one = np.ones_like(s)
    light = np.stack([one, u[..., 0], u[..., 1], s, u[..., 0] * s, u[..., 1] * s, s * s], -1)
    values = p[:, None, _SHAPE:]
    by_s = (values[..., 3] + (values[..., 4:6] * u).sum(-1) + 2.0 * values[..., 6] * s)[..., None]
    shape = np.concatenate([by_corner, by_blur[..., None]], -1) * by_s
    return (light * values).sum(-1), np.concatenate([shape, light], -1)
