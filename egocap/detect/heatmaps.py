"""Heat maps: cell coordinates, training targets, and decoding of points and modes.

The softmax of a label's map of logits is the distribution of its position over the cells.
Cell (row i, column j) has its centre at canonical pixel ((j + 0.5) s - 0.5, (i + 0.5) s - 0.5),
s being the stride.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

RADIUS = 3  # cells; of the window around a peak over which the mean is taken


@dataclass(frozen=True, eq=False)
class Decoded:
    """Points decoded from heat maps; `modes` adds an axis K."""

    points: Float[Array, "*b 2"]  # canonical pixels
    weight: Float[Array, "*b"]  # probability of the window around the peak; 0: no mode


def probabilities(heat: Float[Array, "*b h w"]) -> Float[Array, "*b h w"]:
    """Softmax of maps of logits over their cells."""
    p = np.exp(heat - heat.max((-2, -1), keepdims=True))
    return p / p.sum((-2, -1), keepdims=True)


def decode(heat: Float[Array, "*b h w"], stride: int) -> Decoded:
    """Mean position in the window around each map's highest cell."""
    found = modes(heat, stride, 1)
    return Decoded(found.points[..., 0, :], found.weight[..., 0])


def modes(heat: Float[Array, "*b h w"], stride: int, count: int) -> Decoded:
    """The `count` highest modes of each map; each peak's window is removed before the next.

    A weight of 0 means that a map has no further mode.
    """
    heat = np.asarray(heat)
    shape, (h, w) = heat.shape[:-2], heat.shape[-2:]
    found = probabilities(heat.reshape(-1, h, w))
    p = np.zeros((len(found), h + 2 * RADIUS, w + 2 * RADIUS), found.dtype)
    p[:, RADIUS:-RADIUS, RADIUS:-RADIUS] = found
    every, peaks = np.arange(len(p))[:, None, None], []
    for _ in range(count):
        rows, columns = _window(p.reshape(len(p), -1).argmax(1), w)
        window = every, rows[:, :, None], columns[:, None, :]
        peaks.append((p[window], rows - RADIUS, columns - RADIUS))
        p[window] = 0.0
    inside, rows, columns = (np.stack(parts, 1) for parts in zip(*peaks, strict=True))
    weight = inside.sum((-2, -1))
    total = np.maximum(weight, 1e-30)
    x = (inside.sum(-2) * columns).sum(-1) / total
    y = (inside.sum(-1) * rows).sum(-1) / total
    points = to_pixels(np.stack([x, y], -1), stride)
    return Decoded(points.reshape(*shape, count, 2), weight.reshape(*shape, count))


def to_pixels(cells: Any, stride: int) -> Any:
    """Canonical pixels of positions in cells (0: the first cell's centre)."""
    return (cells + 0.5) * stride - 0.5


def to_cells(pixels: Any, stride: int) -> Any:
    """Positions in cells of canonical pixels, the inverse of `to_pixels`."""
    return (pixels + 0.5) / stride - 0.5


def targets(points: Any, shape: tuple[int, int], stride: int, sigma: Any) -> Any:
    """Maps (..., h, w) that sum to one: Gaussians about canonical points (..., 2), torch.

    `sigma` (...) is in cells. Maps are separable and truncated at the border.
    """
    import torch

    at = to_cells(points, stride)
    h, w = shape
    rows = torch.arange(h, device=points.device, dtype=points.dtype) - at[..., 1:2]
    columns = torch.arange(w, device=points.device, dtype=points.dtype) - at[..., :1]
    scale = -0.5 / (sigma * sigma)[..., None]
    return (
        torch.softmax(scale * rows * rows, -1)[..., :, None]
        * torch.softmax(scale * columns * columns, -1)[..., None, :]
    )


def soft_points(heat: Any, stride: int) -> Any:
    """`decode`'s points (..., 2) of torch logits (..., h, w), differentiable within the windows."""
    import torch

    shape, (h, w) = heat.shape[:-2], heat.shape[-2:]
    border = (RADIUS, RADIUS, RADIUS, RADIUS)
    maps = torch.nn.functional.pad(heat.reshape(-1, h, w), border, value=-torch.inf)
    rows, columns = _window(maps.detach().flatten(1).argmax(1).cpu().numpy(), w)
    rows, columns = (torch.from_numpy(a).to(heat.device) for a in (rows, columns))
    every = torch.arange(len(maps), device=heat.device)[:, None, None]
    picked = maps[every, rows[:, :, None], columns[:, None, :]].float()
    p = torch.softmax(picked.flatten(1), 1).reshape(picked.shape)
    x = (p.sum(1) * (columns - RADIUS)).sum(1)
    y = (p.sum(2) * (rows - RADIUS)).sum(1)
    return to_pixels(torch.stack([x, y], -1), stride).reshape(*shape, 2)


def _window(cells: Array, w: int) -> tuple[Array, Array]:
    """Rows and columns (N, 2 RADIUS + 1) around flat cells (N,) of maps with a border of RADIUS.

    `w` is the width without it. Of a map without a peak: around the first cell inside.
    """
    rows, columns = np.maximum(np.divmod(cells, w + 2 * RADIUS), RADIUS)
    steps = np.arange(-RADIUS, RADIUS + 1)
    return rows[:, None] + steps, columns[:, None] + steps
