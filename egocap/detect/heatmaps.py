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
    p = np.asarray(heat)
    shape, (h, w) = p.shape[:-2], p.shape[-2:]
    p = probabilities(p.reshape(-1, h, w))
    points, weight = _window_means(p, p.reshape(len(p), -1).argmax(1), stride)
    return Decoded(points.reshape(*shape, 2), weight.reshape(shape))


def modes(heat: Float[Array, "*b h w"], stride: int, count: int) -> Decoded:
    """The `count` highest modes of each map; each peak's window is removed before the next.

    A weight of 0 means that a map has no further mode.
    """
    p = np.asarray(heat)
    shape, (h, w) = p.shape[:-2], p.shape[-2:]
    p = probabilities(p.reshape(-1, h, w))
    found = []
    for _ in range(count):
        cells = p.reshape(len(p), -1).argmax(1)
        found.append(_window_means(p, cells, stride))
        rows, columns = _window(cells, h, w)
        p[np.arange(len(p))[:, None, None], rows[:, :, None], columns[:, None, :]] = 0.0
    points = np.stack([f[0] for f in found], 1).reshape(*shape, count, 2)
    return Decoded(points, np.stack([f[1] for f in found], 1).reshape(*shape, count))


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
    flat = heat.reshape(-1, h, w)
    rows, columns = _window(flat.detach().flatten(1).argmax(1).cpu().numpy(), h, w)
    rows, columns = (torch.from_numpy(a).to(heat.device) for a in (rows, columns))
    every = torch.arange(len(flat), device=heat.device)[:, None, None]
    picked = flat[every, rows[:, :, None], columns[:, None, :]].float()
    # a window clipped at the border repeats rows or columns: count each once
    fresh = (_first(rows)[:, :, None] & _first(columns)[:, None, :]).to(picked.device)
    p = torch.softmax(picked.masked_fill(~fresh, -torch.inf).flatten(1), 1).reshape(picked.shape)
    x = (p.sum(1) * columns).sum(1)
    y = (p.sum(2) * rows).sum(1)
    return to_pixels(torch.stack([x, y], -1), stride).reshape(*shape, 2)


def _first(index: Any) -> Any:
    """Mask of the first occurrence of each value in rows of sorted indices."""
    import torch

    return torch.diff(index, dim=1, prepend=index[:, :1] - 1) != 0


def _window(cells: Array, h: int, w: int) -> tuple[Array, Array]:
    """Rows and columns (N, 2 RADIUS + 1) around flat cells (N,), clipped to the map."""
    steps = np.arange(-RADIUS, RADIUS + 1)
    rows, columns = np.divmod(cells, w)
    return (
        np.clip(rows[:, None] + steps, 0, h - 1),
        np.clip(columns[:, None] + steps, 0, w - 1),
    )


def _window_means(p: Float[Array, "n h w"], cells: Array, stride: int) -> tuple[Array, Array]:
    n, h, w = p.shape
    rows, columns = _window(cells, h, w)
    inside = p[np.arange(n)[:, None, None], rows[:, :, None], columns[:, None, :]]
    fresh_rows = np.diff(rows, axis=1, prepend=rows[:, :1] - 1) != 0
    fresh_columns = np.diff(columns, axis=1, prepend=columns[:, :1] - 1) != 0
    inside = inside * fresh_rows[:, :, None] * fresh_columns[:, None, :]
    weight = inside.sum((1, 2))
    total = np.maximum(weight, 1e-30)
    x = (inside.sum(1) * columns).sum(1) / total
    y = (inside.sum(2) * rows).sum(1) / total
    return to_pixels(np.stack([x, y], -1), stride), weight
