"""Skirts and the lower half of dresses: a tube around both legs, skinned to hips and legs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.body_chart import TORSO, BodyChart
from egocap_sim.human.body.triangles import ring_faces
from egocap_sim.human.clothing.drape import fallen, girth, sample
from egocap_sim.human.clothing.shell import Shell

AROUND, ROWS = 64, 13


@dataclass(frozen=True)
class Skirt:
    """Length (1 to the knee, 2 to the ankle), flare and folds of a skirt."""

    length: float
    flare: float  # increase of the radius, metres per metre of length
    fold: float  # half the depth of folds at the hem (m)
    count: int = 9  # folds around


def make_skirt(chart: BodyChart, skirt: Skirt, waist: float, gap: float) -> Shell:
    """A skirt from the waist (height, m), `gap` (m) away from the skin there.

    It lies outside the convex outline of hips and legs at every height. Each half follows the leg
    on its side, with a smooth transition in the middle; the back follows less than the front,
    which a lifted thigh pushes.
    """
    hip, knee, ankle = (chart.joint(b)[2] for b in ("l_thigh", "l_calf", "l_foot"))
    hem = float(np.interp(skirt.length, [0, 1, 2], [hip, knee, ankle]))
    centre = np.array([chart.joint("pelvis")[0], 0.0])
    heights = np.linspace(waist, hem, ROWS)
    reach = fallen(girth(chart.vertices[~chart.on_arm], centre, heights), heights)
    turn = np.linspace(0, 2 * np.pi, AROUND + 1) - np.pi
    drop = np.clip(waist - heights, 0, None)
    below_hips = np.clip(waist - 0.10 - heights, 0, None)
    rings = []
    for i, z in enumerate(heights):
        radius = sample(reach, heights, turn, np.full(len(turn), z)) + gap
        radius = radius + 0.05 * min(1.0, drop[i] / 0.12) * 0.15 + skirt.flare * below_hips[i]
        share = (below_hips[i] / max(below_hips[-1], 1e-6)) ** 0.8
        radius = radius + skirt.fold * share * (1 + np.cos(skirt.count * turn))
        x, y = centre[0] + radius * np.cos(turn), radius * np.sin(turn)
        rings.append(np.column_stack([x, y, np.full(len(turn), z)]))
    turned = rings[-1].copy()
    turned[:, :2] = centre + 0.97 * (turned[:, :2] - centre)
    vertices = np.concatenate([*rings, turned])
    light = np.ones(len(vertices))
    light[-len(turn) :] = 0.5
    light[: len(turn)] = 0.6
    faces = ring_faces(ROWS + 1, AROUND).reshape(ROWS, 2, AROUND, 3)[:, ::-1].reshape(-1, 3)
    return Shell(
        vertices=vertices,
        skin=vertices,
        faces=faces,
        weights=_weights(vertices, chart, waist),
        piece=np.full(len(vertices), TORSO),
        light=light,
        covered=_covered(chart, vertices[:, 2].max(), vertices[:, 2].min()),
    )


def _covered(chart: BodyChart, waist: float, hem: float) -> Bool[Array, "N"]:
    """The skin that is always hidden inside a skirt."""
    z = chart.vertices[:, 2]
    depth = 0.10 + 0.25 * max(0.0, waist - hem - 0.45)  # long skirts open wider at the hem
    inside = (z < waist - 0.03) & (z > hem + depth)
    return ~chart.on_arm & inside & (anatomy().owner != INDEX["head"])


def _weights(points: Float[Array, "M 3"], chart: BodyChart, waist: float) -> Float[Array, "M 21"]:
    hip, knee = chart.joint("l_thigh")[2], chart.joint("l_calf")[2]
    z, y = points[:, 2], points[:, 1]
    front = np.clip((points[:, 0] - chart.joint("pelvis")[0]) / 0.10, -1, 1)
    # In front the lap folds at the hip joint; behind, cloth stretches over the seat.
    ahead = np.clip(front, 0, 1)
    start, length = hip + 0.06 - 0.05 * ahead, 0.20 - 0.10 * ahead
    down = _smooth_step((start - z) / length)
    leg = down * (0.93 + 0.07 * front)
    left = _smooth_step(0.5 + y / 0.20)
    calf = np.clip((knee + 0.08 - z) / 0.22, 0, 1) * (0.7 - 0.15 * front)
    weights = np.zeros((len(points), len(BODIES)))
    spine = np.clip((z - waist + 0.08) / 0.12, 0, 1) * 0.5
    weights[:, INDEX["pelvis"]] = (1 - leg) * (1 - spine)
    weights[:, INDEX["spine"]] = (1 - leg) * spine
    for side, share in (("l_", left), ("r_", 1 - left)):
        weights[:, INDEX[side + "thigh"]] = leg * share * (1 - calf)
        weights[:, INDEX[side + "calf"]] = leg * share * calf
    return weights


def _smooth_step(share: Float[Array, "M"]) -> Float[Array, "M"]:
    share = np.clip(share, 0, 1)
    return share * share * (3 - 2 * share)
