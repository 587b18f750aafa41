"""Lens models as functions of a parameter vector, with their derivatives.

pixel = centre + A(p) r(theta; p) (x, y) / rho, as in `egocap.cameras.camera`. A vector holds the
centre (2), the free entries of the affine matrix A, and the radial parameters. A is symmetric: its
rotation is that of the camera about its axis, which belongs to the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.errors import InputError

_NEWTON = 25
_FX = ((1.0, 0.0), (0.0, 0.0))
_FY = ((0.0, 0.0), (0.0, 1.0))
_SKEW = ((0.0, 1.0), (1.0, 0.0))


@dataclass(frozen=True)
class LensShape:
    """A lens model to fit. `unit` [px] scales OCam's radius so that its parameters are near one."""

    model: str  # of egocap.cameras.lens.MODELS
    degree: int = 0  # of OCam's polynomial
    unit: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters; of the vector that `published` returns."""
        if self.model == "ocam":
            powers = ("a0", *(f"a{k}" for k in self._powers[1:]))
            return ("cx", "cy", "c", "e", *powers)
        radial = ("k1", "k2", "k3", "k4") if self.model == "kannala_brandt" else ()
        return ("cx", "cy", "fx", "fy", *radial)

    @property
    def title(self) -> str:
        """Name of the model with its degree."""
        return f"{self.model} of degree {self.degree}" if self.model == "ocam" else self.model

    @property
    def _powers(self) -> Array:
        return np.array([0, *range(2, self.degree + 1)])  # OCam has no linear term

    @property
    def _affine(self) -> tuple[Array, Array]:
        """The constant part of A and its derivative by each of its parameters."""
        if self.model == "ocam":
            return np.array(_FX), np.array([_FY, _SKEW])
        return np.zeros((2, 2)), np.array([_FX, _FY])

    def affine(self, p: Float[Array, "L"]) -> Float[Array, "2 2"]:
        """The affine matrix A."""
        constant, basis = self._affine
        return constant + np.tensordot(p[2:4], basis, 1)

    def radius(
        self, theta: Float[Array, "N"], p: Float[Array, "L"]
    ) -> tuple[Float[Array, "N"], Float[Array, "N"], Float[Array, "N L-4"]]:
        """r(theta), dr/dtheta, and dr by the radial parameters."""
        if self.model == "ocam":
            return self._ocam_radius(theta, p[4:])
        powers = theta[:, None] ** np.arange(3, 3 + 2 * len(p[4:]), 2)
        exponents = np.arange(3, 3 + 2 * len(p[4:]), 2)
        slope = 1.0 + (exponents * powers / np.maximum(theta, 1e-12)[:, None]) @ p[4:]
        return theta + powers @ p[4:], slope, powers

    def _ocam_radius(self, theta: Array, q: Array) -> tuple[Array, Array, Array]:
        """Solve s cos(theta) = z(s) sin(theta), z(s) = -sum q_k s^k, for s = r / unit by Newton."""
        polynomial = np.zeros(self.degree + 1)
        polynomial[self._powers] = -q
        derivative = np.polynomial.polynomial.polyder(polynomial)
        sine, cosine = np.sin(theta), np.cos(theta)
        s = np.abs(q[0]) * np.minimum(theta, 1.6)
        for _ in range(_NEWTON):
            z = np.polynomial.polynomial.polyval(s, polynomial)
            slope = cosine - np.polynomial.polynomial.polyval(s, derivative) * sine
            step = (s * cosine - z * sine) / slope
            s = np.clip(s - step, 0.0, 8.0)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        z = np.polynomial.polynomial.polyval(s, polynomial)
        slope = cosine - np.polynomial.polynomial.polyval(s, derivative) * sine
        slope = np.where(slope > 1e-6, slope, np.nan)  # past the turn of the polynomial
        by_theta = (s * sine + z * cosine) / slope
        by_q = -(s[:, None] ** self._powers) * (sine / slope)[:, None]
        return self.unit * s, self.unit * by_theta, self.unit * by_q

    def project(
        self, points: Float[Array, "N 3"], p: Float[Array, "L"]
    ) -> tuple[Float[Array, "N 2"], Float[Array, "N 2 3"], Float[Array, "N 2 L"]]:
        """Pixels of points, their derivatives by the points [px/m] and by the parameters.

        Pixels are NaN where the lens turns back.
        """
        x, y, z = points.T
        rho = np.maximum(np.hypot(x, y), 1e-12)
        way = points[:, :2] / rho[:, None]
        radius, slope, by_radial = self.radius(np.arctan2(rho, z), p)
        A, (_, basis) = self.affine(p), self._affine
        flat = way * radius[:, None]
        pixels = p[:2] + flat @ A.T
        squared = rho * rho + z * z
        m = radius / rho
        outer = way[:, :, None] * way[:, None, :]
        by_xy = m[:, None, None] * np.eye(2) + outer * (slope * z / squared - m)[:, None, None]
        by_z = -way * (slope * rho / squared)[:, None]
        by_point = A @ np.concatenate([by_xy, by_z[:, :, None]], 2)
        by_lens = np.empty((len(points), 2, len(p)))
        by_lens[:, :, :2] = np.eye(2)
        by_lens[:, :, 2:4] = np.einsum("kab,nb->nak", basis, flat)
        by_lens[:, :, 4:] = (way @ A.T)[:, :, None] * by_radial[:, None, :]
        return pixels, by_point, by_lens

    def published(self, p: Float[Array, "L"]) -> Float[Array, "L"]:
        """The vector in the units of the camera file: OCam's coefficients for pixels."""
        return p * self.published_scale

    @property
    def published_scale(self) -> Float[Array, "L"]:
        """Factor of each parameter from the vector to the camera file."""
        scale = np.ones(len(self.names))
        if self.model == "ocam":
            scale[4:] = self.unit ** (1.0 - self._powers)
        return scale

    def camera(
        self, p: Float[Array, "L"], size: tuple[int, int], max_angle: float | None = None
    ) -> Camera:
        """The camera. Raises InputError where r does not increase up to `max_angle`."""
        values = self.published(p)
        parameters: tuple[float, ...] = tuple(map(float, values[4:]))
        if self.model == "ocam":
            parameters = (parameters[0], 0.0, *parameters[1:])
        rows = tuple(tuple(map(float, row)) for row in self.affine(p))
        centre = (float(p[0]), float(p[1]))
        return Camera(self.model, *size, centre, rows, parameters, max_angle)  # type: ignore


def lens_shapes(model: str | None, size: tuple[int, int]) -> list[LensShape]:
    """The lens shapes to choose from: all, or those of one model. Raises InputError."""
    unit = max(size) / 2.0
    shapes = [LensShape("equidistant"), LensShape("kannala_brandt"),
              *(LensShape("ocam", degree, unit) for degree in (4, 5, 6))]  # fmt: skip
    found = [shape for shape in shapes if model in (None, shape.model)]
    if not found:
        raise InputError(f"unknown lens model '{model}'",
                         valid=sorted({s.model for s in shapes}))  # fmt: skip
    return found


def convert(
    shape: LensShape, p: Float[Array, "L"], to: LensShape, widest: float
) -> Float[Array, "L2"]:
    """The parameters of another shape nearest to a lens, fitted over [0, widest] radians."""
    theta = np.linspace(0.02, widest, 200)
    radius, _, _ = shape.radius(theta, p)
    A = shape.affine(p)
    if to.model == "ocam":
        s = radius * A[0, 0] / to.unit
        z = s / np.tan(theta)
        q = np.linalg.lstsq(-(s[:, None] ** to._powers), z, rcond=None)[0]
        return np.array([*p[:2], A[1, 1] / A[0, 0], A[0, 1] / A[0, 0], *q])
    powers = theta[:, None] ** np.arange(1, 2 + 2 * (len(to.names) - 4), 2)
    k = np.linalg.lstsq(powers, radius, rcond=None)[0]
    return np.array([*p[:2], k[0] * A[0, 0], k[0] * A[1, 1], *(k[1:] / k[0])])
