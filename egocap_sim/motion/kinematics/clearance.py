"""Distance of the arms from the rest of the body, to detect self-penetration."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics.clip import Clip

_BONES = (
    ("pelvis", "chest", 0.13), ("chest", "neck", 0.11), ("neck", "head", 0.08),
    ("l_thigh", "l_calf", 0.075), ("r_thigh", "r_calf", 0.075),
    ("l_calf", "l_foot", 0.05), ("r_calf", "r_foot", 0.05),
    ("l_foot", "l_toe", 0.045), ("r_foot", "r_toe", 0.045),
)  # fmt: skip
"""Capsules that an arm must not penetrate: two joints and the radius in metres."""
_HEAD = (0.14, 0.12)  # metres from the skull base up to the head's middle, and its radius
_FOREARM, _HAND = 0.04, 0.02  # radii
_TO_FINGERS = 0.3  # from the wrist, in forearms: where a half closed hand ends
_TO_PALM = 0.085  # metres from the wrist


def clearance(clip: Clip) -> Float[Array, "T"]:
    """Least distance [m] of forearms and hands to trunk, head, legs, each other and the floor.

    It is negative for penetration.
    """
    p, up = clip.positions, clip.rotations[:, INDEX["head"], :, 2]
    head = p[:, INDEX["head"]] + _HEAD[0] * up
    arms = [_arm(clip, s) for s in ("l_", "r_")]
    radius = np.where(np.arange(8) < 5, _FOREARM, _HAND)[1:]
    least = np.full(len(p), np.inf)
    for arm in arms:
        for a, b, thick in _BONES:
            away = _distance(arm, p[:, INDEX[a]], p[:, INDEX[b]]) - thick - radius
            least = np.minimum(least, away.min(1))
        away = np.linalg.norm(arm - head[:, None], axis=-1) - _HEAD[1] - radius
        least = np.minimum(least, np.minimum(away, arm[..., 2] - radius).min(1))
    apart = np.linalg.norm(arms[0][:, :, None] - arms[1][:, None], axis=-1)
    return np.minimum(least, (apart - radius[:, None] - radius).min((1, 2)))


def palms(clip: Clip) -> tuple[Float[Array, "T 2 3"], Float[Array, "T 2 3"]]:
    """Centres of the palms and their normals, world."""
    middle, facing = [], []
    for s, inward in (("l_", -1.0), ("r_", 1.0)):
        R = clip.rotations[:, INDEX[s + "hand"]]
        middle.append(clip.positions[:, INDEX[s + "hand"]] - _TO_PALM * R[:, :, 2])
        facing.append(inward * R[:, :, 1])
    return np.stack(middle, 1), np.stack(facing, 1)


def _arm(clip: Clip, side: str) -> Float[Array, "T 7 3"]:
    """Points from beyond the elbow to the fingers."""
    elbow, wrist = (clip.positions[:, INDEX[side + b]] for b in ("forearm", "hand"))
    length = np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    fingers = wrist - _TO_FINGERS * length * clip.rotations[:, INDEX[side + "hand"], :, 2]
    fore = np.linspace(0.0, 1.0, 6)[1:, None]
    hand = np.linspace(0.0, 1.0, 3)[1:, None]
    return np.concatenate(
        [
            elbow[:, None] + fore * (wrist - elbow)[:, None],
            wrist[:, None] + hand * (fingers - wrist)[:, None],
        ],
        1,
    )


def _distance(
    points: Float[Array, "T N 3"], a: Float[Array, "T 3"], b: Float[Array, "T 3"]
) -> Float[Array, "T N"]:
    """Distance of points from line segments, metres."""
    along = (b - a)[:, None]
    share = ((points - a[:, None]) * along).sum(-1) / (along * along).sum(-1)
    nearest = a[:, None] + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points - nearest, axis=-1)
