"""Neutral controls of standing, the base of gestures and postures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.curves import slow_noise, turn
from egocap_sim.motion.kinematics.posing import SIDES, Controls

HALF_WIDTH = 0.095  # metres from the middle to each ankle
TOE_OUT = 0.13  # radians
HANG = np.array([0.03, 0.055, -0.555])
"""Wrist of a hanging left arm, from the shoulder in the chest's frame."""
HANG_PRONATION = 0.35
HIP_HEIGHT = figure.REST[0, 2] - 0.006  # height of the pelvis joint while standing


@dataclass(frozen=True)
class Style:
    """Individual style of movement, drawn once per motion."""

    handed: float  # +1 left, -1 right
    tempo: float  # factor on the duration of moves
    slouch: float  # radians the chest leans forward
    sway: float  # factor on the idle movement
    gaze_down: float  # radians the resting head points down
    wander: float = 1.0  # factor on the idle turning of the head


def draw_style(rng: np.random.Generator) -> Style:
    return Style(
        handed=1.0 if rng.random() < 0.12 else -1.0,
        tempo=float(np.exp(rng.normal(0.0, 0.1))),
        slouch=float(rng.uniform(0.0, 0.09)),
        sway=float(rng.uniform(0.7, 1.3)),
        gaze_down=float(rng.uniform(0.02, 0.14)),
    )


def feet(T: int) -> tuple[Array, Array]:
    """Ankles (T,2,3) and foot rotations (T,2,3,3) planted on either side of the origin."""
    ankle, R = np.empty((T, 2, 3)), np.empty((T, 2, 3, 3))
    for i, (_, sign) in enumerate(SIDES):
        ankle[:, i] = (0.0, sign * HALF_WIDTH, figure.offset("l_foot", "pelvis")[2])
        ankle[:, i, 2] += figure.REST[0, 2]
        R[:, i] = turn(yaw=sign * TOE_OUT)
    return ankle, R


def standing(t: Float[Array, "T"], style: Style, rng: np.random.Generator) -> Controls:
    """Stand at the origin facing +x with hanging arms, breathing and shifting weight.

    The idle movement fades in and out at both ends, so that clips join smoothly.
    """
    T = len(t)
    ends = np.clip(np.minimum(t, t[-1] - t) / 0.8, 0.0, 1.0)
    ends = style.sway * ends * ends * (3.0 - 2.0 * ends)
    shift = ends * slow_noise(t, rng, 0.05, 0.2)
    ahead = ends * slow_noise(t, rng, 0.08, 0.4)
    lean = ends * slow_noise(t, rng, 0.05, 0.3)
    breath = ends * np.sin(2.0 * np.pi * 0.27 * t + rng.uniform(0.0, 6.28))
    pelvis = np.stack([0.012 + 0.006 * ahead, 0.013 * shift, np.full(T, HIP_HEIGHT)], -1)
    pelvis[:, 2] -= 0.006 * np.abs(shift)
    ankle, foot_R = feet(T)
    wrist, pronation = np.empty((T, 2, 3)), np.full((T, 2), HANG_PRONATION)
    for i, (_, sign) in enumerate(SIDES):
        wrist[:, i] = HANG * [1.0, sign, 1.0]
        wrist[:, i, 0] += 0.012 * ends * slow_noise(t, rng, 0.1, 0.5)
        wrist[:, i, 2] += 0.004 * breath
    return Controls(
        pelvis=pelvis,
        pelvis_R=turn(yaw=0.02 * lean, roll=0.02 * shift),
        chest_R=turn(
            yaw=0.03 * lean,
            pitch=style.slouch + 0.012 * breath + 0.01 * ahead,
            roll=-0.012 * shift,
        ),
        head_R=turn(
            yaw=0.05 * style.wander * ends * slow_noise(t, rng, 0.05, 0.3),
            pitch=style.gaze_down + 0.02 * style.wander * ends * slow_noise(t, rng, 0.1, 0.5),
        ),
        ankle=ankle,
        foot_R=foot_R,
        toe=np.zeros((T, 2)),
        wrist=wrist,
        pronation=pronation,
        wrist_bend=np.zeros((T, 2)),
        swivel=np.zeros((T, 2)),
    )
