"""Patches of grey pictures: sampling under an affine map, correlation, sub-pixel alignment (numba).

A patch is a square of SIDE x SIDE samples around a pixel. A 2 x 2 matrix A maps offsets in the
reference picture to offsets in another one.
Source: inverse compositional alignment, Baker and Matthews 2004.
"""

from __future__ import annotations

import numpy as np
from numba import njit

REACH = 4
SIDE = 2 * REACH + 1
FLAT = 1.0
"""Standard deviation of grey values below which a patch has no texture."""
_ROUNDING = 1e-6  # px


@njit(cache=True, nogil=True)
def _grey(image, u, v):
    """Grey value at a pixel in the picture, bilinear."""
    i, j = int(v), int(u)
    b, a = v - i, u - j
    top = (1.0 - a) * image[i, j] + a * image[i, j + 1]
    bottom = (1.0 - a) * image[i + 1, j] + a * image[i + 1, j + 1]
    return (1.0 - b) * top + b * bottom


@njit(cache=True, nogil=True)
def _inside(image, u, v, A, reach):
    """Whether the corners of a patch, and so all of it, lie in the picture."""
    height, width = image.shape
    x = reach * (abs(A[0, 0]) + abs(A[0, 1])) + _ROUNDING
    y = reach * (abs(A[1, 0]) + abs(A[1, 1])) + _ROUNDING
    return u - x > 0.0 and v - y > 0.0 and u + x < width - 1 and v + y < height - 1


@njit(cache=True, nogil=True)
def patch(image, u, v, A, reach, out):
    """Sample a patch of side 2 reach + 1 into `out`; whether it lies in the picture."""
    if not _inside(image, u, v, A, reach):
        return False
    n = 0
    for y in range(-reach, reach + 1):
        for x in range(-reach, reach + 1):
            out[n] = _grey(image, u + A[0, 0] * x + A[0, 1] * y, v + A[1, 0] * x + A[1, 1] * y)
            n += 1
    return True


@njit(cache=True, nogil=True)
def normalise(values):
    """Subtract the mean and divide by the standard deviation, in place; the latter."""
    mean, squared = 0.0, 0.0
    for value in values:
        mean += value
    mean /= len(values)
    for n in range(len(values)):
        values[n] -= mean
        squared += values[n] * values[n]
    deviation = np.sqrt(squared / len(values))
    if deviation > 1e-9:
        for n in range(len(values)):
            values[n] /= deviation
    return deviation


@njit(cache=True, nogil=True)
def correlations(reference, pixels, image, candidates, A, valid, spacing):
    """Correlation (N, H) of each pixel's patch with those of its candidates; -1: none.

    pixels (N, 2) in `reference`; candidates (N, H, 2) in `image` with maps A (N, H, 2, 2). Samples
    are `spacing` pixels apart in the reference.
    """
    N, H = candidates.shape[:2]
    scores, template = np.full((N, H), np.float32(-1.0)), np.empty(SIDE * SIDE)
    straight, grey = np.eye(2) * spacing, image.astype(np.float32)
    maps, places = (A * spacing).astype(np.float32), candidates.astype(np.float32)
    number = np.arange(SIDE * SIDE)
    x = (number % SIDE - REACH).astype(np.float32)
    y = (number // SIDE - REACH).astype(np.float32)
    for n in range(N):
        if not patch(reference, pixels[n, 0], pixels[n, 1], straight, REACH, template):
            continue
        if normalise(template) < FLAT:
            continue
        wanted = template.astype(np.float32)
        for h in range(H):
            u, v = places[n, h]
            if valid[n, h] and _inside(image, u, v, maps[n, h], REACH):
                scores[n, h] = _correlation(grey, u, v, maps[n, h], x, y, wanted)
    return scores


@njit(cache=True, nogil=True, fastmath=True)
def _correlation(grey, u, v, A, x, y, template):
    """Correlation of a normalised template with a patch in the picture; -1: no texture there.

    One loop in single precision without branches, which processors do for many samples at once.
    """
    width, flat, count = np.int32(grey.shape[1]), grey.ravel(), np.float32(len(x))
    middle, ux, uy, vx, vy = grey[np.int32(v), np.int32(u)], A[0, 0], A[0, 1], A[1, 0], A[1, 1]
    total, squared, product = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for n in range(len(x)):
        p, q = u + ux * x[n] + uy * y[n], v + vx * x[n] + vy * y[n]
        i, j = np.int32(q), np.int32(p)
        b, a = q - np.float32(i), p - np.float32(j)
        at = np.uint32(i * width + j)
        top = flat[at] + a * (flat[at + np.uint32(1)] - flat[at])
        at += np.uint32(width)
        bottom = flat[at] + a * (flat[at + np.uint32(1)] - flat[at])
        value = top + b * (bottom - top) - middle
        total += value
        squared += value * value
        product += template[n] * value
    variance = squared / count - (total / count) ** 2
    if variance < np.float32(FLAT * FLAT):
        return np.float32(-1.0)
    return product / (count * np.sqrt(variance))


@njit(cache=True, nogil=True)
def align(templates, image, pixels, A, rounds, farthest):
    """Move each pixel (N, 2) to where its template fits; returns pixels and correlations (N,).

    templates (N, (SIDE + 2)^2): a patch and its border, grey values. A (N, 2, 2). A pixel that
    moves farther than `farthest` or out of the picture has the correlation -1.
    """
    N, wide = len(pixels), SIDE + 2
    moved, score = pixels.copy(), np.full(N, -1.0)
    inner, other = np.empty(SIDE * SIDE), np.empty(SIDE * SIDE)
    gradient = np.empty((SIDE * SIDE, 2))
    for n in range(N):
        T = templates[n].reshape(wide, wide)
        _inner(T, inner, gradient)
        deviation = normalise(inner)
        if deviation < FLAT:
            continue
        h00, h01, h11 = 0.0, 0.0, 0.0
        for k in range(len(inner)):
            h00 += gradient[k, 0] * gradient[k, 0]
            h01 += gradient[k, 0] * gradient[k, 1]
            h11 += gradient[k, 1] * gradient[k, 1]
        det = h00 * h11 - h01 * h01
        if det < 1e-6 * (h00 + h11) ** 2:
            continue
        for _ in range(rounds):
            u, v = moved[n]
            if not patch(image, u, v, A[n], REACH, other) or normalise(other) < FLAT:
                score[n] = -1.0
                break
            g0, g1, agreement = 0.0, 0.0, 0.0
            for k in range(len(inner)):
                error = (other[k] - inner[k]) * deviation
                g0 += gradient[k, 0] * error
                g1 += gradient[k, 1] * error
                agreement += other[k] * inner[k]
            score[n] = agreement / len(inner)
            x, y = (h11 * g0 - h01 * g1) / det, (h00 * g1 - h01 * g0) / det
            moved[n, 0] = u - (A[n, 0, 0] * x + A[n, 0, 1] * y)
            moved[n, 1] = v - (A[n, 1, 0] * x + A[n, 1, 1] * y)
            away = (moved[n, 0] - pixels[n, 0]) ** 2 + (moved[n, 1] - pixels[n, 1]) ** 2
            if away > farthest * farthest:
                score[n] = -1.0
                break
            if x * x + y * y < 1e-4:
                break
    return moved, score


@njit(cache=True, nogil=True)
def _inner(T, inner, gradient):
    """Patch without its border, and its central differences."""
    n = 0
    for i in range(1, T.shape[0] - 1):
        for j in range(1, T.shape[1] - 1):
            inner[n] = T[i, j]
            gradient[n, 0] = 0.5 * (T[i, j + 1] - T[i, j - 1])
            gradient[n, 1] = 0.5 * (T[i + 1, j] - T[i - 1, j])
            n += 1


@njit(cache=True, nogil=True)
def sharpness(templates):
    """Inverse standard deviation (N,) of an aligned patch's place in its worse direction [1/px].

    For grey values with a standard deviation of one. Source: Foerstner and Guelch 1987.
    """
    inner, gradient = np.empty(SIDE * SIDE), np.empty((SIDE * SIDE, 2))
    found = np.empty(len(templates))
    for n in range(len(templates)):
        _inner(templates[n].reshape(SIDE + 2, SIDE + 2), inner, gradient)
        h00, h11 = np.sum(gradient[:, 0] ** 2), np.sum(gradient[:, 1] ** 2)
        h01 = np.sum(gradient[:, 0] * gradient[:, 1])
        middle, half = 0.5 * (h00 + h11), 0.5 * (h00 - h11)
        found[n] = np.sqrt(max(middle - np.sqrt(half * half + h01 * h01), 0.0))
    return found


@njit(cache=True, nogil=True)
def templates_at(image, pixels):
    """Patches with a border of one sample (N, (SIDE + 2)^2); whether they are in the picture."""
    N, side = len(pixels), SIDE + 2
    found, inside = np.zeros((N, side * side), np.float32), np.zeros(N, np.bool_)
    straight = np.eye(2)
    for n in range(N):
        inside[n] = patch(image, pixels[n, 0], pixels[n, 1], straight, REACH + 1, found[n])
    return found, inside
