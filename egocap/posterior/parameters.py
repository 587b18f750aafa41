"""What a posterior is about: 37 angles, and on request bone scales and small errors of the rig."""

from __future__ import annotations

from collections.abc import Sequence

from egocap.body.skeleton import DOFS, POINTS
from egocap.posterior.config import PosteriorConfig

SCALES: dict[str, tuple[str, ...]] = {
    "trunk": ("neck", "upper_spine", "lower_spine"),
    "shoulders": ("clavicle", "shoulder"),
    "upper_arms": ("elbow",),
    "forearms": ("wrist",),
    "hands": ("hand",),
    "hips": ("hip",),
    "thighs": ("knee",),
    "shanks": ("ankle",),
    "feet": ("foot",),
}
"""Bones that grow together, by the point at their far end, left and right alike."""

RIG_ERRORS = ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")
"""Of one camera, in its own axes: the point's coordinates are turned, then shifted."""

UNSCALED = -1


def names(config: PosteriorConfig, views: Sequence[str]) -> tuple[str, ...]:
    """Names of all parameters in order: angles, scales (ln of the factor), rig errors."""
    scales = [f"scale_{group}" for group in SCALES] if config.bone_scales else []
    rig = [f"{view}_{error}" for view in views for error in RIG_ERRORS] if config.rig_errors else []
    return (*DOFS, *scales, *rig)


def scale_of_point() -> tuple[int, ...]:
    """Index into `SCALES` for each of `skeleton.POINTS`; UNSCALED for the head."""
    kinds = {point: i for i, group in enumerate(SCALES.values()) for point in group}
    return tuple(
        kinds.get(point.removeprefix("left_").removeprefix("right_"), UNSCALED) for point in POINTS
    )
