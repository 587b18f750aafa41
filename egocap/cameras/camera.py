"""Fisheye cameras: project points, cast rays, and the derivatives, for any angle off the axis.

Every model is pixel = centre + affine @ (r(theta) * (x, y) / rho), rho = |(x, y)| and
theta = atan2(rho, z) of a point in the camera frame; the models differ in r(theta) alone
(`cameras.lens`). Points and pixels may be numpy arrays (computed in float64) or torch tensors (in
their own precision, on their own device, differentiable).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import degrees, isfinite, pi
from typing import Any

import numpy as np

from egocap.cameras.lens import MODELS, Radial, namespace
from egocap.errors import InputError

Affine = tuple[tuple[float, float], tuple[float, float]]

MAX_PIXELS = 65536  # largest side of an image
TINY = 1e-30  # squared distance below which a point is on the optical axis, or at the camera
ANGLE_SLACK = 1e-9  # rad; includes points on the edge of the field of view


@dataclass(frozen=True)
class Camera:
    """A calibrated camera.

    `max_angle` None is replaced by the largest angle within the image. Raises InputError for values
    out of range.
    """

    model: str  # a key of egocap.cameras.lens.MODELS
    width: int
    height: int
    centre: tuple[float, float]  # pixel of the optical axis; (0, 0) is the top-left pixel's centre
    affine: Affine  # pixels per unit of r(theta); focal lengths on the diagonal
    parameters: tuple[float, ...] = ()  # Kannala-Brandt k1..k4; OCam a0, a1, ... (a0 < 0)
    max_angle: float = None  # type: ignore[assignment]  # rad off axis

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"unknown camera model '{self.model}'", valid=MODELS)
        for name, size in (("width", self.width), ("height", self.height)):
            if not (isinstance(size, int) and 1 <= size <= MAX_PIXELS):
                raise InputError(f"image {name} is {size}", valid=f"1 to {MAX_PIXELS} pixels")
        numbers = (*self.centre, *self.affine[0], *self.affine[1], *self.parameters)
        if not all(isfinite(n) and abs(n) < 1e12 for n in numbers):
            raise InputError("a camera number is not finite, or beyond 1e12")
        determinant = np.linalg.det(np.array(self.affine))
        if not determinant > 1e-9:
            raise InputError(
                f"the focal lengths or affine matrix have the determinant {determinant:.3g}",
                valid="above zero: an image neither flat nor mirrored",
            )
        if self.max_angle is not None and not 0.0 < self.max_angle <= pi:
            raise InputError(
                f"half the field of view is {self.max_angle:.6g} rad", valid="above 0, up to pi"
            )
        lens = MODELS[self.model](self.parameters, self.max_angle, self._image_radius())
        object.__setattr__(self, "max_angle", lens.limit)
        self.__dict__["radial"] = lens

    def __repr__(self) -> str:
        cone = 2.0 * degrees(self.max_angle)
        return f"Camera({self.model}, {self.width} x {self.height}, {cone:.0f} degrees)"

    @cached_property
    def radial(self) -> Radial:
        """The radial function r(theta) of the lens."""
        raise AssertionError("set by __post_init__")

    def project(self, points: Any) -> tuple[Any, Any]:
        """Pixels (..., 2) and validity (...) of points (..., 3) [m] in the camera frame.

        Valid: not at the camera, within `max_angle`, inside the image. Pixels of invalid points are
        finite and not clamped; their radius grows with the angle.
        """
        points = _floating(points)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        rho, theta = _polar(x, y, z)
        radius, _ = self.radial.radius(theta)
        pixels = self._to_pixels(x * (radius / rho), y * (radius / rho))
        return pixels, self._in_field(x, y, z, theta) & self._inside(pixels)

    def project_jacobian(self, points: Any) -> tuple[Any, Any, Any]:
        """`project` with its derivative: pixels (..., 2), J (..., 2, 3) [px/m], validity (...)."""
        points = _floating(points)
        xp = namespace(points)
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        rho, theta = _polar(x, y, z)
        radius, slope = self.radial.radius(theta)
        m = radius / rho
        dx, dy = x / rho, y / rho  # direction in the image plane; zero on the axis
        d2 = rho * rho + z * z
        radial = slope * z / d2 - m
        axial = -slope * rho / d2
        row_x = (m + dx * dx * radial, dx * dy * radial, dx * axial)
        row_y = (dx * dy * radial, m + dy * dy * radial, dy * axial)
        (a, b), (c, d) = self.affine
        J = xp.stack(
            [
                xp.stack([a * p + b * q for p, q in zip(row_x, row_y, strict=True)], -1),
                xp.stack([c * p + d * q for p, q in zip(row_x, row_y, strict=True)], -1),
            ],
            -2,
        )
        pixels = self._to_pixels(x * m, y * m)
        return pixels, J, self._in_field(x, y, z, theta) & self._inside(pixels)

    def ray(self, pixels: Any) -> tuple[Any, Any]:
        """Unit rays (..., 3) in the camera frame and validity (...) of pixels (..., 2).

        Valid: inside the image and within `max_angle`. The inverse of `project`.
        """
        pixels = _floating(pixels)
        xp = namespace(pixels)
        (a, b), (c, d) = np.linalg.inv(np.array(self.affine)).tolist()
        u, v = pixels[..., 0] - self.centre[0], pixels[..., 1] - self.centre[1]
        x, y = a * u + b * v, c * u + d * v
        radius = _length(x, y)
        theta = self.radial.angle(radius)
        s = xp.sin(theta) / radius
        rays = xp.stack([x * s, y * s, xp.cos(theta)], -1)
        return rays, (theta <= self.max_angle + ANGLE_SLACK) & self._inside(pixels)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with its image scaled to width x height pixels.

        The outer border of the image, half a pixel beyond the outermost pixel centres, is kept.
        """
        sx, sy = width / self.width, height / self.height
        (a, b), (c, d) = self.affine
        return replace(
            self,
            width=width,
            height=height,
            centre=((self.centre[0] + 0.5) * sx - 0.5, (self.centre[1] + 0.5) * sy - 0.5),
            affine=((a * sx, b * sx), (c * sy, d * sy)),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready form, read by `camera_from_dict`."""
        d = {name: value for name, value in asdict(self).items() if name != "parameters"}
        d |= {"centre": list(self.centre), "affine": [list(row) for row in self.affine]}
        return d | ({"parameters": list(self.parameters)} if self.parameters else {})

    def _image_radius(self) -> float:
        """Largest lens radius of an image corner."""
        (cx, cy), (w, h) = self.centre, (self.width - 0.5, self.height - 0.5)
        corners = np.array([(u - cx, v - cy) for u in (-0.5, w) for v in (-0.5, h)])
        return float(np.linalg.norm(corners @ np.linalg.inv(np.array(self.affine)).T, axis=1).max())

    def _to_pixels(self, x: Any, y: Any) -> Any:
        (a, b), (c, d) = self.affine
        u, v = a * x + b * y + self.centre[0], c * x + d * y + self.centre[1]
        return namespace(x).stack([u, v], -1)

    def _in_field(self, x: Any, y: Any, z: Any, theta: Any) -> Any:
        return (x * x + y * y + z * z > TINY) & (theta <= self.max_angle + ANGLE_SLACK)

    def _inside(self, pixels: Any) -> Any:
        u, v = pixels[..., 0], pixels[..., 1]
        return (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)


def _floating(array: Any) -> Any:
    return np.asarray(array, np.float64) if namespace(array) is np else array


def _length(x: Any, y: Any) -> Any:
    """|(x, y)|, bounded away from zero so that ratios and derivatives stay finite."""
    xp = namespace(x)
    squared = x * x + y * y
    return xp.sqrt(xp.where(squared > TINY, squared, xp.full_like(squared, TINY)))


def _polar(x: Any, y: Any, z: Any) -> tuple[Any, Any]:
    rho = _length(x, y)
    return rho, namespace(x).arctan2(rho, z)
