"""Whether a board is flat: its bend, from the residuals of an adjustment that took it for flat.

The height of a board's point over its plane is the quadratic form c . (x^2, y^2, x y), with x and y
from the board's middle in units of half its longer side, so that c is in metres at the edges.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.calibration.adjustment import Adjusted, further_unknowns
from egocap.calibration.state import Corners, by_view


def bend(
    adjusted: Adjusted, corners: Corners, board: Board
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """The coefficients c of a board's bend along its normal, away from the viewer, and their
    covariance, metres."""
    return further_unknowns(adjusted, corners, board.points, _by_bend(adjusted, corners, board))


def bend_basis(board: Board) -> Float[Array, "K 3"]:
    """x^2, y^2 and x y of a board's corners."""
    x, y = ((board.points[:, :2] - np.array(board.size) / 2) / (max(board.size) / 2)).T
    return np.column_stack([x * x, y * y, x * y])


def _by_bend(adjusted: Adjusted, corners: Corners, board: Board) -> Float[Array, "N 2 3"]:
    state, basis = adjusted.state, bend_basis(board)[corners.corner]
    by = np.zeros((len(corners), 2, 3))
    for seen in by_view(state, corners, board.points):
        _, by_point, _ = state.shapes[seen.view].project(seen.points, state.lenses[seen.view])
        normals = state.boards(seen.view, corners.instant[seen.at])[:, :3, 2]
        along = normals @ state.T_view_rig[seen.view, :3, :3].T
        by_height = np.einsum("nij,nj->ni", by_point, along)
        by[seen.at] = by_height[:, :, None] * basis[seen.at, None, :]
    return by
