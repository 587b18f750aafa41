"""Drape of loose cloth: it hangs from chest and hips and bridges hollows and legs."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

ANGLES = 48  # directions around the body
LEVELS = 20  # heights
INWARD = 0.35  # largest inward slope of hanging cloth, metres per metre


def drape(
    cloth: Float[Array, "N 3"],
    where: Bool[Array, "N"],
    centre: Float[Array, "2"],
    span: tuple[float, float],
    freedom: float,
) -> Float[Array, "N 3"]:
    """Let cloth between two heights (m, upper first) hang by a share `freedom` (0 to 1)."""
    top, bottom = span
    heights = np.linspace(top, bottom - 0.03, LEVELS)
    here = where & (cloth[:, 2] < top) & (cloth[:, 2] > bottom - 0.06)
    slice_ = cloth[where & (cloth[:, 2] < top + 0.05) & (cloth[:, 2] > bottom - 0.09)]
    reach = fallen(girth(slice_, centre, heights), heights)
    offset = cloth[here, :2] - centre
    radius = np.linalg.norm(offset, axis=1)
    wanted = sample(reach, heights, np.arctan2(offset[:, 1], offset[:, 0]), cloth[here, 2])
    begin = np.clip((top - cloth[here, 2]) / 0.10, 0, 1)
    further = freedom * begin * np.maximum(wanted - radius, 0)
    moved = cloth.copy()
    moved[here, :2] += offset * (further / np.maximum(radius, 1e-6))[:, None]
    return moved


def girth(
    points: Float[Array, "N 3"], centre: Float[Array, "2"], heights: Float[Array, "L"]
) -> Float[Array, "L A"]:
    """Radius (m) of the convex outline of points about a vertical axis, by height and azimuth.

    The azimuths run from -pi to pi.
    """
    step = abs(heights[1] - heights[0])
    angles = 2 * np.pi * np.arange(ANGLES) / ANGLES - np.pi
    axes = np.stack([np.cos(angles), np.sin(angles)])
    cosine = np.cos(angles[:, None] - angles[None, :])
    reach = np.zeros((len(heights), ANGLES))
    for i, z in enumerate(heights):
        near = points[np.abs(points[:, 2] - z) < 0.75 * step, :2] - centre
        if not len(near):
            reach[i] = reach[i - 1]
            continue
        support = (near @ axes).max(0)  # support function of the outline
        # Radius of the convex outline: the nearest tangent along each direction.
        met = np.where(cosine > 0.2, support[None, :] / np.maximum(cosine, 0.2), np.inf)
        reach[i] = met.min(1)
    return reach


def fallen(reach: Float[Array, "L A"], heights: Float[Array, "L"]) -> Float[Array, "L A"]:
    """Radius of cloth that hangs from the levels above; `heights` run downward."""
    result = reach.copy()
    for i in range(1, len(heights)):
        drop = heights[i - 1] - heights[i]
        result[i] = np.maximum(reach[i], result[i - 1] - INWARD * drop)
    return result


def sample(
    reach: Float[Array, "L A"],
    heights: Float[Array, "L"],
    angle: Float[Array, "N"],
    z: Float[Array, "N"],
) -> Float[Array, "N"]:
    """Interpolate the radius at angles and heights."""
    row = np.clip((heights[0] - z) / (heights[0] - heights[1]), 0, len(heights) - 1.001)
    column = (angle + np.pi) / (2 * np.pi) * ANGLES
    r, c = row.astype(int), column.astype(int)
    s, t = row - r, column - c
    a, b = reach[:, c % ANGLES], reach[:, (c + 1) % ANGLES]
    n = np.arange(len(z))
    low, high = ((1 - t) * a[k, n] + t * b[k, n] for k in (r, r + 1))
    return (1 - s) * low + s * high
