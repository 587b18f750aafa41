"""Association of detections with the wearer's joints: modes of heat maps, and swapped sides.

In a crowd the highest mode may be another person's limb, and left may be detected as right. Given a
pose close to the truth (the prediction, or the whole track), the sides of a view are exchanged, and
other modes of a joint taken, where that lowers the energy by more than its cost.

Source: EgoCap 2016, section 4.3.3, which takes the maximum alone; this extends it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from egocap.body.kinematics import pose_skeleton
from egocap.body.labels import LABEL_INDEX, MIRROR
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.observations import OPPOSITE, Modes, Observations


class Sides(NamedTuple):
    """Labels that are swapped together. An argument, as numba's cache misses changed tables."""

    limbs: Int[Array, "2 8"]  # of both arms, and of both legs
    mirror: Int[Array, "18"]  # the same label on the other side


_SIDES = Sides(
    np.array([
        [LABEL_INDEX[f"{side}_{part}"] for side in ("left", "right") for part in parts]
        for parts in (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "foot"))
    ]),
    np.array(MIRROR),
)  # fmt: skip


class FrameModes(NamedTuple):
    """The other modes of one frame, as `Modes` has them."""

    rays: Float[Array, "K V 18 3"]
    whiten: Float[Array, "K V 18 2 3"]
    weights: Float[Array, "K V 18"]
    cost: Float[Array, "K V 18"]


def needs_association(observations: Observations, config: TrackerConfig) -> bool:
    """Whether there is anything to choose between."""
    return config.fix_swaps or observations.modes is not None


def associate(
    angles: Float[Array, "T 37"], proposed: Observations, chosen: Observations, model: Model,
    config: TrackerConfig,
) -> int:  # fmt: skip
    """Write into `chosen` the detections of `proposed` that fit the poses best.

    Returns in how many frames they differ from those chosen before.
    """
    swap_cost = float(config.swap_cost) if config.fix_swaps else np.inf
    return sum(
        associate_frame(
            model, pose, proposed.frame(t), _modes(proposed.modes, t, proposed.weights.shape[1]),
            _SIDES, float(config.robust_scale), swap_cost, chosen.frame(t),
        )
        for t, pose in enumerate(angles)
    )  # fmt: skip


def _modes(modes: Modes | None, t: int, views: int) -> FrameModes:
    if modes is not None:
        return FrameModes(modes.rays[t], modes.whiten[t], modes.weights[t], modes.cost[t])
    empty = np.zeros((0, views, len(MIRROR)))
    return FrameModes(
        np.zeros((*empty.shape, 3)), np.zeros((*empty.shape, 2, 3)), empty, empty
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _energy(point, centre, ray, whiten, weight, scale2):
    """Half the Geman-McClure loss of one detection."""
    if weight <= 0.0:
        return 0.0
    D = point - centre
    distance = max(np.sqrt((D * D).sum()), OPPOSITE)
    D /= distance
    towards = 1.0 + (ray * D).sum()
    if towards <= OPPOSITE or distance <= OPPOSITE:
        return 0.5 * weight * scale2
    e0 = 2.0 * (whiten[0] * D).sum() / towards
    e1 = 2.0 * (whiten[1] * D).sum() / towards
    squared = e0 * e0 + e1 * e1
    return 0.5 * weight * squared * scale2 / (squared + scale2)


@njit(cache=True, nogil=True)
def _detection_energy(seen, v, label, point, scale2):
    return _energy(
        point, seen.centres[v], seen.rays[v, label], seen.whiten[v, label], seen.weights[v, label],
        scale2,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _unswap(points, label_points, seen, v, sides, scale2, swap_cost, source):
    """Into `source` (18,): the label whose detection in view v is taken for each label."""
    for label in range(len(source)):
        source[label] = label
    for g in range(len(sides.limbs)):
        gain = 0.0
        for label in sides.limbs[g]:
            X = points[label_points[label]]
            gain += _detection_energy(seen, v, label, X, scale2)
            gain -= _detection_energy(seen, v, sides.mirror[label], X, scale2)
        if gain > swap_cost:
            for label in sides.limbs[g]:
                source[label] = sides.mirror[label]


@njit(cache=True, nogil=True)
def associate_frame(model, angles, seen, modes, sides, scale, swap_cost, chosen):
    """Choose one frame's detections by its pose; whether the choice changed.

    `seen` are the `Rays` of the frame as detected, `modes` its `FrameModes`; the choice is written
    into the `Rays` `chosen`.
    """
    points, _ = pose_skeleton(model, angles)
    scale2 = scale * scale
    source = np.empty(len(model.label_points), np.int64)
    changed = False
    for v in range(len(seen.centres)):
        _unswap(points, model.label_points, seen, v, sides, scale2, swap_cost, source)
        for label in range(len(source)):
            s = source[label]
            ray, W, weight = seen.rays[v, s], seen.whiten[v, s], seen.weights[v, s]
            if len(modes.rays) > 0 and seen.weights[v, label] > 0.0:
                X = points[model.label_points[label]]
                best = _energy(X, seen.centres[v], ray, W, weight, scale2)
                for k in range(len(modes.rays)):
                    if modes.weights[k, v, label] <= 0.0:
                        continue
                    energy = modes.cost[k, v, label] + _energy(
                        X, seen.centres[v], modes.rays[k, v, label], modes.whiten[k, v, label],
                        modes.weights[k, v, label], scale2,
                    )  # fmt: skip
                    if energy < best:
                        best = energy
                        ray, W = modes.rays[k, v, label], modes.whiten[k, v, label]
                        weight = modes.weights[k, v, label]
            if (chosen.weights[v, label] != weight or chosen.rays[v, label, 0] != ray[0]
                    or chosen.rays[v, label, 1] != ray[1]):  # fmt: skip
                changed = True
                chosen.rays[v, label] = ray
                chosen.whiten[v, label] = W
                chosen.weights[v, label] = weight
    return changed
