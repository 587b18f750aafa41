"""Convert cameras of any model to OCam calibrations: JSON and OCamCalib's text."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.camera import Camera

_DEGREE = 9  # of the polynomial from pixels to rays
_INVERSE_DEGREE = 14


def ocam_calibration(camera: Camera, name: str) -> dict[str, Any]:
    """The JSON of UnrealEgo, EgoWholeMocap and EgoRear: keys as in their calibration files.

    `polynomialC2W` gives z of the ray at radius rho; `polynomialW2C` gives rho at the angle off the
    axis minus a right angle; lowest order first. Other lens models are fitted by least squares over
    their field of view, for common lenses within 0.1 px.
    """
    (a, b), (c, d) = camera.affine
    theta = np.linspace(1e-3, camera.max_angle, 2000)
    rho = a * np.asarray(camera.radial.radius(theta)[0])
    if camera.model == "ocam" and a == 1.0:
        forward = np.array(camera.parameters)
    else:
        forward = _fitted(rho, -rho / np.tan(theta), (0, *range(2, _DEGREE + 1)))
    angles = np.concatenate([[-np.pi / 2], theta - np.pi / 2])
    backward = _fitted(angles, np.concatenate([[0.0], rho]), tuple(range(_INVERSE_DEGREE + 1)))
    return {
        "name": name,
        "size": [camera.width, camera.height],
        "imageCircleRadius": float(rho[-1]),
        "image_center": list(camera.centre),
        "polynomialC2W": forward.tolist(),
        "polynomialW2C": backward.tolist(),
        "affine": [d / a, c / a, b / a],
    }


def ocam_text(camera: Camera) -> tuple[str, float]:
    """OCamCalib's calib_results.txt, and the largest error of the lens [px]."""
    data = ocam_calibration(camera, "")
    (column, row), polynomial = data["image_center"], data["polynomialC2W"]
    parts = (
        ("polynomial from pixels to rays", [len(polynomial), *polynomial]),
        ("inverse polynomial", [len(data["polynomialW2C"]), *data["polynomialW2C"]]),
        ("centre: row, column", [row, column]),
        ("affine: c, d, e", data["affine"]),
        ("size: height, width", [camera.height, camera.width]),
    )
    lines = (f"# {name}\n{' '.join(map(repr, numbers))}\n" for name, numbers in parts)
    return "\n".join(lines), ocam_error(camera, data)


def ocam_error(camera: Camera, data: dict[str, Any]) -> float:
    """Largest distance [px] between a camera and its `ocam_calibration`, over its field of view."""
    c, d, e = data["affine"]
    radius = camera.radial.radius(np.linspace(1e-3, camera.max_angle, 200))[0]
    theta = np.linspace(1e-3, camera.max_angle, 200)
    fitted = Camera(
        "ocam", camera.width, camera.height, camera.centre, ((1.0, e), (d, c)),
        tuple(data["polynomialC2W"]), camera.max_angle * (1.0 - 1e-9),
    )  # fmt: skip
    scale = np.linalg.norm(np.array(camera.affine), 2), np.linalg.norm(np.array(fitted.affine), 2)
    return float(np.abs(scale[0] * radius - scale[1] * fitted.radial.radius(theta)[0]).max())


def _fitted(
    x: Float[Array, "n"], y: Float[Array, "n"], powers: tuple[int, ...]
) -> Float[Array, "m"]:
    """Least-squares coefficients, lowest order first, of a polynomial of these powers."""
    scale = np.abs(x).max()
    found = np.linalg.lstsq((x[:, None] / scale) ** np.array(powers), y, rcond=None)[0]
    coefficients = np.zeros(max(powers) + 1)
    coefficients[list(powers)] = found / scale ** np.array(powers)
    return coefficients
