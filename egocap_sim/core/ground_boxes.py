"""Raised level ground to walk on: treads and landings of stairs, as flat boxes in the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

THICKNESS = 0.04  # metres


@dataclass(frozen=True)
class GroundBox:
    """An axis-aligned box whose top supports feet; metres."""

    low: tuple[float, float]  # x, y
    high: tuple[float, float]
    top: float

    @property
    def centre(self) -> Float[Array, "3"]:
        """Centre of the box."""
        x, y = np.add(self.low, self.high) / 2
        return np.array([x, y, self.top - THICKNESS / 2])

    @property
    def size(self) -> Float[Array, "3"]:
        """Edge lengths of the box."""
        return np.array([*np.subtract(self.high, self.low), THICKNESS])


def ground_height(
    ground_boxes: Sequence[GroundBox], xy: Float[Array, "*n 2"], margin_m: float = 0.0
) -> Float[Array, "*n"]:
    """Height of the ground at points: of the highest box, widened by a margin, or the floor."""
    height = np.zeros(xy.shape[:-1])
    for box in ground_boxes:
        low, high = np.array(box.low) - margin_m, np.array(box.high) + margin_m
        over = ((xy >= low) & (xy <= high)).all(-1)
        height = np.where(over, np.maximum(height, box.top), height)
    return height
