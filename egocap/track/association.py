"""Which of the places that a detector proposes for a joint is the wearer's: the one the body fits.

In a crowd the higher peak may be a stranger's limb, and left may be taken for right. Given a pose
close to the truth (the prediction, or the whole track), every view's sides are exchanged, and every
joint's other modes taken, where that lowers the energy by more than it costs.

Source: EgoCap 2016, section 4.3.3, where only the maximum counts; this is the extension of it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap.body.kinematics import pose_skeleton
from egocap.body.labels import LABEL_INDEX, LABELS, MIRROR
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import Model
from egocap.pose.observations import Observations

_GROUPS = np.array([
    [LABEL_INDEX[f"{side}_{part}"] for side in ("left", "right") for part in parts]
    for parts in (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "foot"))
])  # fmt: skip
_MIRROR = np.array(MIRROR)


def can_choose(observations: Observations, config: TrackerConfig) -> bool:
    """Whether there is anything to choose."""
    return config.swaps or observations.modes is not None


def choose(
    angles: Float[Array, "T 37"], proposed: Observations, taken: Observations, model: Model,
    config: TrackerConfig, first: int = 0,
) -> int:  # fmt: skip
    """Write into `taken` the places of `proposed` that fit the poses of frames from `first` on.

    Returns how many frames end up with other places than were taken before.
    """
    shape = proposed.weights.shape[1:]
    modes = proposed.modes
    changed = 0
    none = np.zeros((0, *shape, 3)), np.zeros((0, *shape, 2, 3)), np.zeros((0, *shape))
    for t in range(first, first + len(angles)):
        others = (*none, none[2]) if modes is None else (
            modes.rays[t], modes.whiten[t], modes.weights[t], modes.price[t]
        )  # fmt: skip
        changed += choose_frame(
            model, angles[t - first], proposed.centres,
            proposed.rays[t], proposed.whiten[t], proposed.weights[t], *others, _GROUPS, _MIRROR,
            float(config.robust_scale), config.swap_price if config.swaps else np.inf,
            taken.rays[t], taken.whiten[t], taken.weights[t],
        )  # fmt: skip
    return changed


@njit(cache=True)
def _cost(point, centre, ray, whiten, weight, scale2):
    """Robust energy of one place, half Geman-McClure."""
    if weight <= 0.0:
        return 0.0
    D = point - centre
    D /= max(np.sqrt((D * D).sum()), 1e-6)
    towards = max(1.0 + (ray * D).sum(), 1e-6)
    e0 = 2.0 * (whiten[0] * D).sum() / towards
    e1 = 2.0 * (whiten[1] * D).sum() / towards
    squared = e0 * e0 + e1 * e1
    return 0.5 * weight * squared * scale2 / (squared + scale2)


@njit(cache=True)
def choose_frame(
    model, angles, centres, rays, whiten, weights, mode_rays, mode_whiten, mode_weights, price,
    groups, mirror, scale, swap_price, out_rays, out_whiten, out_weights,
):  # fmt: skip
    """One frame's choice into the `out` arrays (V, 18, ...); whether they changed."""
    points, _ = pose_skeleton(model, angles)
    scale2 = scale * scale
    labels = len(model.label_points)
    source = np.empty(labels, np.int64)
    changed = False
    for v in range(len(centres)):
        for label in range(labels):
            source[label] = label
        for g in range(len(groups)):
            gain = 0.0
            for label in groups[g]:
                X = points[model.label_points[label]]
                other = mirror[label]
                gain += _cost(X, centres[v], rays[v, label], whiten[v, label], weights[v, label],
                              scale2)  # fmt: skip
                gain -= _cost(X, centres[v], rays[v, other], whiten[v, other], weights[v, other],
                              scale2)  # fmt: skip
            if gain > swap_price:
                for label in groups[g]:
                    source[label] = mirror[label]
        for label in range(labels):
            s = source[label]
            ray, W, weight = rays[v, s], whiten[v, s], weights[v, s]
            if len(mode_rays) > 0 and weights[v, label] > 0.0:
                X = points[model.label_points[label]]
                best = _cost(X, centres[v], ray, W, weight, scale2)
                for k in range(len(mode_rays)):
                    if mode_weights[k, v, label] <= 0.0:
                        continue
                    cost = price[k, v, label] + _cost(
                        X, centres[v], mode_rays[k, v, label], mode_whiten[k, v, label],
                        mode_weights[k, v, label], scale2,
                    )  # fmt: skip
                    if cost < best:
                        best = cost
                        ray, W = mode_rays[k, v, label], mode_whiten[k, v, label]
                        weight = mode_weights[k, v, label]
            if (out_weights[v, label] != weight or out_rays[v, label, 0] != ray[0]
                    or out_rays[v, label, 1] != ray[1]):  # fmt: skip
                changed = True
                out_rays[v, label] = ray
                out_whiten[v, label] = W
                out_weights[v, label] = weight
    return changed


assert len(LABELS) == len(_MIRROR)
