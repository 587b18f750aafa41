"""Bring the wrists of posed controls to places in the world."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.posing import SIDES, Controls, pose_figure


def aim_wrists(
    controls: Controls, wrist: Float[Array, "T 2 3"], share: Float[Array, "T 2"] | float = 1.0
) -> Controls:
    """Controls whose wrists are, by a share, at world places [m]; the rest is as it was."""
    clip = pose_figure("aim", 1.0, controls)
    chest, at = clip.rotations[:, INDEX["chest"]], clip.positions[:, INDEX["chest"]]
    wanted = np.empty_like(controls.wrist)
    for i, (side, _) in enumerate(SIDES):
        shoulder = at + chest @ figure.offset(side + "upperarm", "chest")
        wanted[:, i] = np.einsum("tij,ti->tj", chest, wrist[:, i] - shoulder)
    share = np.broadcast_to(share, controls.wrist.shape[:2])[..., None]
    return dataclasses.replace(controls, wrist=controls.wrist + share * (wanted - controls.wrist))


def hermite(
    s: Float[Array, "T"], a: Array, b: Array, slope_a: Array, slope_b: Array
) -> Float[Array, "T 3"]:
    """Cubic curve over s in 0..1 between points with given slopes (per unit of s)."""
    s = s[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * a
        + s * s * (3 - 2 * s) * b
        + s * (1 - s) ** 2 * slope_a
        - s * s * (1 - s) * slope_b
    )
