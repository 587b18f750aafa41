"""Pose the standard figure from a few curves: pelvis, trunk, gaze, ankles, wrists."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.figure_solver import SIDES, solve
from egocap_sim.motion.kinematics.forward_kinematics import offsets

__all__ = ["SIDES", "Controls", "pose_figure"]

FULL_LEG = 0.996  # of its length: the pelvis sinks rather than a leg being straighter
_OFFSETS = offsets(figure.REST)


@dataclass(eq=False)
class Controls:
    """Curves of a motion; T frames, sides left then right. World frame unless said otherwise."""

    pelvis: Float[Array, "T 3"]  # joint position
    pelvis_R: Float[Array, "T 3 3"]
    chest_R: Float[Array, "T 3 3"]
    head_R: Float[Array, "T 3 3"]
    ankle: Float[Array, "T 2 3"]
    foot_R: Float[Array, "T 2 3 3"]
    toe: Float[Array, "T 2"]  # radians the toes bend up from the foot
    wrist: Float[Array, "T 2 3"]  # from the shoulder at rest, in the chest's frame
    pronation: Float[Array, "T 2"]  # radians; 0 is thumb up, positive turns the palm down
    wrist_bend: Float[Array, "T 2"]  # radians; positive towards the palm's back (extension)
    swivel: Float[Array, "T 2"] = field(default_factory=lambda: np.zeros((1, 2)))
    """Radians the elbow is raised about the line shoulder to wrist from where it would hang."""
    splay: Float[Array, "T 2"] | None = None
    """Radians each knee points outward from the way the hips face; None: it goes with the foot.

    Given, elbows too turn smoothly wherever the hands go; else they hang as in ordinary motions.
    """


def pose_figure(name: str, fps: float, controls: Controls) -> Clip:
    """Solve the figure's 21 bodies for the controls; canonical rotations."""
    c, T = controls, len(controls.pelvis)
    p, R = solve(
        _curve(_within_reach(c)),
        _curve(np.stack([c.pelvis_R, c.chest_R, c.head_R], 1)),
        _curve(c.ankle),
        _curve(c.foot_R),
        _curve(c.toe),
        _curve(c.wrist),
        _curve(np.stack([c.pronation, c.wrist_bend, np.broadcast_to(c.swivel, (T, 2))], -1)),
        _curve(np.zeros((T, 2)) if c.splay is None else c.splay),
        c.splay is not None,
        _OFFSETS,
    )
    return Clip(name, fps, p, R, canonical=True)


def _curve(values: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """An array of the kind that the compiled solver takes."""
    return np.array(values, float, order="C")


def _within_reach(c: Controls) -> Float[Array, "T 3"]:
    """Pelvis positions lowered, smoothly, to where both legs reach their ankles."""
    from scipy.ndimage import gaussian_filter1d, minimum_filter1d

    full = FULL_LEG * (figure.THIGH + figure.CALF)
    too_high = np.zeros(len(c.pelvis))
    for i, (side, _) in enumerate(SIDES):
        hip = c.pelvis + c.pelvis_R @ figure.offset(side + "thigh", "pelvis")
        flat = np.linalg.norm((hip - c.ankle[:, i])[:, :2], axis=1)
        highest = c.ankle[:, i, 2] + np.sqrt(np.maximum(full**2 - flat**2, 0.01))
        too_high = np.maximum(too_high, hip[:, 2] - highest)
    if too_high.max() <= 0.0:
        return c.pelvis
    drop = gaussian_filter1d(-minimum_filter1d(-too_high, 7, mode="nearest"), 2.0, mode="nearest")
    return c.pelvis - np.maximum(drop, too_high)[:, None] * [0.0, 0.0, 1.0]
