"""Compiled whiteners of rays: directions near a ray in standard deviations of its detection."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def whiten_rays(ray, J, sigma, model, R, rays, whiten):
    """Rays (T, M, 18, 3) and whiteners (T, M, 18, 2, 3) of a view in the head frame, into the last
    two arguments.

    `ray` are the rays and J (T, M, 18, 2, 3) the derivatives of the pixels by them in the camera
    frame, `sigma` (T, M, 18) the detections' standard deviations in pixels, `model` (18,) those of
    the skeleton in radians, R the camera's rotation. A whitener W gives the distance |W d| of a
    direction d from the ray in standard deviations.
    """
    T, M, labels = sigma.shape
    tangent, W = np.empty((2, 3)), np.empty((2, 3))
    for t in range(T):
        for m in range(M):
            for label in range(labels):
                place = t, m, label
                _tangents(ray[place], tangent)
                by = J[place]
                a, b = _dot(by[0], tangent[0]), _dot(by[0], tangent[1])
                c, d = _dot(by[1], tangent[0]), _dot(by[1], tangent[1])
                # The covariance along the tangents: of the pixels' error, and of the skeleton's.
                scale, own = (sigma[place] / (a * d - b * c)) ** 2, model[label] ** 2
                xx = scale * (d * d + b * b) + own
                yy = scale * (c * c + a * a) + own
                xy = -scale * (d * c + b * a)
                # With its inverse L L^T, |L^T x| is x in standard deviations.
                l00, l11 = np.sqrt(yy / (xx * yy - xy * xy)), 1.0 / np.sqrt(yy)
                l10 = -xy * l00 / yy
                for k in range(3):
                    W[0, k] = l00 * tangent[0, k] + l10 * tangent[1, k]
                    W[1, k] = l11 * tangent[1, k]
                for k in range(3):
                    whiten[t, m, label, 0, k] = _dot(R[k], W[0])
                    whiten[t, m, label, 1, k] = _dot(R[k], W[1])
                    rays[t, m, label, k] = _dot(R[k], ray[place])


@njit(cache=True, nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _tangents(ray, tangent):
    """`observations.tangent_basis` of one ray, into `tangent` (2, 3)."""
    x, y, z = ray
    if abs(x) <= min(abs(y), abs(z)):
        a, b, c = 0.0, z, -y
    elif abs(y) <= abs(z):
        a, b, c = -z, 0.0, x
    else:
        a, b, c = y, -x, 0.0
    length = np.sqrt(a * a + b * b + c * c)
    a, b, c = a / length, b / length, c / length
    tangent[0, 0], tangent[0, 1], tangent[0, 2] = a, b, c
    tangent[1, 0], tangent[1, 1], tangent[1, 2] = y * c - z * b, z * a - x * c, x * b - y * a
