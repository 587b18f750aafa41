"""Radial projection functions r(theta) of the camera models.

theta is the angle off the optical axis [rad], r the radius in the lens's own unit (pixels for OCam,
radians for the others; the camera's affine matrix maps it to pixels). All models share one form,
r = theta * q(s) with q a polynomial in s = (theta - middle) / half. Projection and its inverse take
numpy arrays and torch tensors.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from math import degrees, inf, pi
from types import ModuleType
from typing import Any

import numpy as np

from egocap.errors import InputError

FIT_TOLERANCE = 1e-5  # pixels; largest error of an inverted OCam polynomial
_FIT_DEGREES = (8, 12, 16, 20, 24, 28, 32)
_SHORTEST = 0.001  # pixels; smallest OCam focal length
_REACH = 16.0  # search range of an OCam polynomial, times the radius of the farthest corner
NEWTON_STEPS = 60  # bisection alone needs about 52 in float64


def namespace(array: Any) -> ModuleType:
    """torch for a tensor, numpy for any other array."""
    torch = sys.modules.get("torch")
    return torch if torch is not None and isinstance(array, torch.Tensor) else np


@dataclass(frozen=True)
class Radial:
    """r(theta) = theta * q((theta - middle) / half) up to `limit`, linear beyond it.

    The linear extension is monotone and differentiable, so that solvers get useful gradients for
    points outside the field of view.
    """

    coefficients: tuple[float, ...]  # of q, lowest order first
    limit: float  # rad; r increases strictly on [0, limit]
    middle: float = 0.0
    half: float = 1.0

    def radius(self, theta: Any) -> tuple[Any, Any]:
        """Radius and slope dr/dtheta at angles [rad] of any shape."""
        inner = namespace(theta).clip(theta, None, self.limit)
        s = (inner - self.middle) / self.half
        q, dq = 0.0 * s, 0.0 * s
        for c in reversed(self.coefficients):  # Horner, value and derivative together
            dq = dq * s + q
            q = q * s + c
        slope = q + inner * dq / self.half
        return inner * q + slope * (theta - inner), slope

    def angle(self, radius: Any) -> Any:
        """Angles [rad] of radii (>= 0), the inverse of `radius`.

        The search is not differentiated: a last Newton step from its detached result gives autograd
        the exact derivative of the inverse.
        """
        xp = namespace(radius)
        edge, slope = (float(v) for v in self.radius(np.float64(self.limit)))
        fixed = radius.detach() if hasattr(radius, "detach") else radius
        inner = xp.clip(fixed, None, edge)
        theta = invert(self.radius, inner, self.limit, start=inner * (self.limit / edge))
        theta = theta + xp.clip(fixed - edge, 0.0, None) / slope
        value, slope = self.radius(theta)
        return theta - (value - radius) / slope


def invert(function: Callable[[Any], tuple[Any, Any]], target: Any, high: float, start: Any) -> Any:
    """Solve function(x) = target for x in [0, high] by bracketed Newton steps.

    `function` is increasing and returns value and slope. A step out of the bracket is replaced by a
    bisection.
    """
    xp = namespace(target)
    low, x, top = 0.0 * target, start, 0.0 * target + high
    tolerance = 4.0 * float(xp.finfo(target.dtype).eps) * high
    for _ in range(NEWTON_STEPS):
        value, slope = function(x)
        low, top = xp.where(value <= target, x, low), xp.where(value >= target, x, top)
        step = x - (value - target) / xp.where(slope > 0, slope, xp.ones_like(slope))
        new = xp.where((step >= low) & (step <= top), step, 0.5 * (low + top))
        moved, x = new - x, new
        if not bool((abs(moved) > tolerance).any()):
            break
    return x


def equidistant(parameters: tuple[float, ...], max_angle: float | None, radius: float) -> Radial:
    """r = theta. `max_angle` defaults to `radius`, at most 180 degrees."""
    if parameters:
        raise InputError("an equidistant lens has no parameters")
    return Radial((1.0,), min(radius, pi) if max_angle is None else max_angle)


def kannala_brandt(parameters: tuple[float, ...], max_angle: float | None, radius: float) -> Radial:
    """r = theta + k1 theta^3 + k2 theta^5 + k3 theta^7 + k4 theta^9, and up to k8 theta^17.

    Raises InputError unless r increases up to `max_angle` or, without one, to half the radius of
    the farthest image corner.
    Source: Kannala and Brandt 2006, as in OpenCV's fisheye module.
    """
    if not 4 <= len(parameters) <= 8:
        raise InputError(f"{len(parameters)} distortion coefficients",
                         valid="k1, k2, k3, k4, and up to k8")  # fmt: skip
    powers = (0.0, *(c for k in parameters for c in (0.0, k)))  # of r / theta, after the constant 1
    coefficients = (1.0, *powers[1:])
    slope = [c * (i + 1) for i, c in enumerate(coefficients)]
    lens = Radial(coefficients, min(_first_root(slope, pi), pi))
    return _limited(lens, max_angle, radius)


def ocam(parameters: tuple[float, ...], max_angle: float | None, radius: float) -> Radial:
    """The lens whose pixel at radius rho has the ray [u, v, f(rho)], f(rho) = sum a_k rho^k.

    OCamCalib's sign: a_0 < 0, so theta(rho) = atan2(rho, -f(rho)). Its inverse r(theta) has no
    closed form and is interpolated at Chebyshev points to `FIT_TOLERANCE`. Rays use the inverse of
    the interpolant, so that project and ray are inverse to rounding error.

    Raises InputError unless theta(rho) increases up to `max_angle` or, without one, to half the
    radius of the farthest image corner.
    Source: Scaramuzza et al. 2006, Eq. 6; EgoCap paper, section 4.2.
    """
    a = np.array(parameters, float)
    if a.size == 0 or a[0] > -_SHORTEST:
        raise InputError(
            "the polynomial's first coefficient is not negative",
            valid=f"minus the focal length, at most -{_SHORTEST} pixels",
        )

    def angle(rho: Any) -> tuple[Any, Any]:
        z = -np.polynomial.polynomial.polyval(rho, a)
        dz = -np.polynomial.polynomial.polyval(rho, np.polynomial.polynomial.polyder(a))
        return np.arctan2(rho, z), (z - rho * dz) / (rho * rho + z * z)

    # theta increases while the polynomial z - rho dz/drho > 0.
    reach = _REACH * radius
    high = min(reach, _first_root([-c * (1 - k) for k, c in enumerate(parameters)], reach))
    widest = float(angle(np.float64(high))[0])
    if max_angle is None:
        _refuse_early_turn(widest, high, radius)
        max_angle = float(angle(np.float64(radius))[0]) if radius < high else 0.98 * widest
    if not max_angle < widest:
        raise _not_growing(widest, f"the field of view reaches {degrees(max_angle):.2f}")

    def quotient(theta: Any) -> Any:
        rho = invert(angle, theta, high, start=np.clip(-a[0] * theta, 0.0, high))
        return np.where(theta > 1e-9, rho / np.maximum(theta, 1e-9), -a[0])

    half = 0.5 * max_angle
    grid = np.linspace(0.0, max_angle, 400)
    truth = grid * quotient(grid)
    error = inf
    for degree in _FIT_DEGREES:
        nodes = np.polynomial.chebyshev.chebpts1(degree + 1)
        series = np.polynomial.chebyshev.chebfit(nodes, quotient(half * (nodes + 1.0)), degree)
        coefficients = np.polynomial.chebyshev.cheb2poly(series)
        lens = Radial(tuple(map(float, coefficients)), max_angle, half, half)
        error = float(np.abs(lens.radius(grid)[0] - truth).max())
        if error < FIT_TOLERANCE:
            return lens
    raise InputError(
        f"the polynomial cannot be inverted to {FIT_TOLERANCE} px up to {degrees(max_angle):.1f} "
        f"degrees off axis (best {error:.2g} px)",
        valid="a smooth lens, or a smaller field of view",
    )


MODELS: dict[str, Callable[[tuple[float, ...], float | None, float], Radial]] = {
    "equidistant": equidistant,
    "kannala_brandt": kannala_brandt,
    "ocam": ocam,
}
"""Camera models: (parameters, max_angle [rad] or None, radius of the image) -> Radial."""


def _limited(lens: Radial, max_angle: float | None, radius: float) -> Radial:
    if max_angle is None:
        edge = float(lens.radius(np.float64(lens.limit))[0])
        if lens.limit < pi:
            _refuse_early_turn(lens.limit, edge, radius)
        max_angle = float(lens.angle(np.float64(radius))) if radius < edge else 0.98 * lens.limit
    elif max_angle > lens.limit:
        raise _not_growing(lens.limit, f"the field of view reaches {degrees(max_angle):.2f}")
    return Radial(lens.coefficients, max_angle, lens.middle, lens.half)


def _refuse_early_turn(angle: float, turn: float, radius: float) -> None:
    """Raise InputError unless r increases to half the radius of the farthest corner."""
    if turn < 0.5 * radius:
        raise _not_growing(angle, "the image extends further")


def _not_growing(turn: float, but: str) -> InputError:
    return InputError(
        f"the lens polynomial is not monotone: it increases up to {degrees(turn):.2f} degrees off "
        f"axis only, and {but}",
        valid=f"a field of view under {2 * degrees(turn):.2f} degrees, or another polynomial",
    )


def _first_root(coefficients: list[float], high: float) -> float:
    """Smallest root in (0, high] of a polynomial, lowest order first; inf without one.

    Negligible leading terms are dropped: dividing by them would overflow.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.array(coefficients) * high ** np.arange(len(coefficients))
    if not np.isfinite(scaled).all():
        raise InputError("the lens polynomial overflows inside the image")
    largest = abs(scaled).max()
    kept = np.flatnonzero(abs(scaled) > 1e-16 * largest)[-1] + 1 if largest > 0 else 1
    roots = np.polynomial.polynomial.polyroots(scaled[:kept])
    real = roots.real[(abs(roots.imag) <= 1e-9 * abs(roots)) & (roots.real > 0)]
    first = float(real.min(initial=inf))
    return first * high if first <= 1.0 else inf
