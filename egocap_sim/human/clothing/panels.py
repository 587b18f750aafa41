"""Texture layout of a garment: one rectangular panel for each piece of cloth.

A piece (torso, sleeve, trouser leg) is a cylinder cut open on its hidden side. The columns of its
panel are the turn (0 to 1) around the piece, the rows metres along it. Panels of sleeves and legs
lie side by side below the torso.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.body_chart import ARMS, LEGS, LIMBS, TORSO

SIZE = 512  # px of a garment's texture
REACH = 1.12  # turns that a panel covers: triangles on the cut extend beyond one turn
GIRTH = {TORSO: 0.96, **dict.fromkeys(ARMS, 0.30), **dict.fromkeys(LEGS, 0.48)}  # m


@dataclass(frozen=True)
class Panel:
    """A piece's rectangle in the texture (px) and its extent; `along` decreases down the rows."""

    piece: int
    column: int
    row: int
    width: int
    height: int
    top: float  # m along the piece at the upper edge
    bottom: float

    @property
    def turns(self) -> Float[Array, "W"]:
        """Turn of each column."""
        return (np.arange(self.width) + 0.5) / self.width * REACH

    @property
    def along(self) -> Float[Array, "H"]:
        """Metres along the piece of each row."""
        rows = (np.arange(self.height) + 0.5) / self.height
        return self.top + rows * (self.bottom - self.top)

    def x(self, turn: Array | float) -> Array | float:
        """Column of a turn, from the left edge of the panel."""
        return np.asarray(turn) / REACH * self.width

    def y(self, along: Array | float) -> Array | float:
        """Row of a position along the piece, from the upper edge of the panel."""
        return (np.asarray(along) - self.top) / (self.bottom - self.top) * self.height

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns of the texture."""
        return (
            slice(self.row, self.row + self.height),
            slice(self.column, self.column + self.width),
        )

    def uv(self, turn: Array, along: Array) -> Float[Array, "N 2"]:
        """Texture coordinates, at least a pixel away from the rows of other panels."""
        x = self.column + self.x(turn)
        y = self.row + np.clip(self.y(along), 1.0, self.height - 1.0)
        return np.stack([x, y], 1) / SIZE


def lay_out(spans: Mapping[int, tuple[float, float]]) -> dict[int, Panel]:
    """Place the panels of pieces; `spans` holds the largest and the smallest `along` of each."""
    limbs = sorted(p for p in spans if p != TORSO)
    rows = 0  # of the torso
    panels = {}
    if TORSO in spans:
        length, *others = (spans[p][0] - spans[p][1] for p in (TORSO, *limbs))
        rows = round(SIZE * length / max(length + max(others, default=0.0), 1e-6))
        rows = int(np.clip(rows, 32, SIZE - 32)) if limbs else SIZE
        panels[TORSO] = Panel(TORSO, 0, 0, SIZE, rows, *spans[TORSO])
    for i, piece in enumerate(limbs):
        width = SIZE // len(limbs)
        panels[piece] = Panel(piece, i * width, rows, width, SIZE - rows, *spans[piece])
    return panels


def unroll(
    piece: int, points: Float[Array, "N 3"], body: BareBody
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Turns (0 to 1) around a piece's axis, from its hidden side, and metres along it.

    The turn 0.5 is the front of torso and legs and the outer side of arms. `along` is the height
    on the torso, and minus the distance from shoulder or hip on a limb.
    """
    if piece == TORSO:
        low, high = body.joints[INDEX["pelvis"]], body.joints[INDEX["neck"]]
        x = points[:, 0] - (low[0] + high[0]) / 2
        radius = np.hypot(x, points[:, 1])
        # Cloth on the shoulders runs inward as well as up: both count as length.
        slope = np.clip((points[:, 2] - (high[2] - 0.16)) / 0.10, 0, 1)
        turn = np.arctan2(points[:, 1], x) / (2 * np.pi) + 0.5
        return turn, points[:, 2] + slope * np.maximum(0, 0.2 - radius)
    a, b, c = (body.joints[INDEX[name]] for name in LIMBS[piece][:3])
    first, second = unit(b - a), unit(c - b)
    length = np.linalg.norm(b - a)
    upper = np.minimum((points - a) @ first, length)
    lower = np.maximum((points - b) @ second, 0.0)
    out = points - (a + upper[:, None] * first + lower[:, None] * second)
    axis = unit(c - a)
    hidden = np.array([0, -np.sign(a[1]), -0.3]) if piece in ARMS else np.array([-1.0, 0, 0])
    e1 = unit(-hidden + (hidden @ axis) * axis)
    turn = np.arctan2(out @ np.cross(axis, e1), out @ e1) / (2 * np.pi) + 0.5
    return turn, -(upper + lower)
