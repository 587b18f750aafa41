"""How a body stands to its head, and the seconds of footage in which that tells the rig's rotation.

A wearer who is asked to stand upright and look at the horizon straight ahead does so within about 2
degrees, each time anew: each return is a measurement of its own. A nod, a turn or a tilt leaves its
axis by some degrees too, so that it measures the rotation about the other axes. Footage is cut into
attempts where the lean or turn of the body against the head leaves or enters that of the first
stance.

Source: Cooke & Wei 1988 (the head's natural position is repeated within 2 degrees). Winter 1995,
"Human balance and posture control", and Winter 2009, "Biomechanics and Motor Control", table 4.1
(segment masses).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.ndimage import median_filter

from egocap.body.labels import LABEL_INDEX
from egocap.errors import InputError
from egocap.fitting.bundle_adjustment import joint_derivatives

NEUTRAL_FRAMES = 4
"""Frames of each attempt that take part. More of one posture hardly tell more about the rotation,
and lengthen the neck, whose direction is found anew from noise in each."""
RETURNED = np.deg2rad(9.0)
"""Largest angle of head to body from the first neutral stance at which it counts as taken again."""
UPRIGHT = 0.93
"""Least height of the mass above the feet, as a part of that in the first neutral stance."""
HELD_S = 0.4
"""Seconds that an attempt lasts at least."""
MOVE_WEIGHT = 0.4
"""Information of a move about the axes that it is not about, against that of a stance."""
SUPPORT = 0.35
"""Place of the centre of pressure between ankle and ball of the foot."""
_SMOOTH_S = 0.35
_MASSES = {"head": 0.081, "shoulder": 0.2765, "elbow": 0.044, "wrist": 0.028, "hip": 0.3485,
           "knee": 0.1465, "ankle": 0.061, "foot": 0.0145}  # fmt: skip
"""Share of the body's mass at a kind of joint, both sides: half of each segment's at either end;
the trunk's at shoulders and hips."""
_PAIRS = ("shoulder", "hip", "ankle")
"""Joints whose lines from right to left are square to the gaze."""


def neutral_weights(
    times: Float[Array, "T"], used: Int[Array, "T"], joints: Float[Array, "T 18 3"],
    neutral: tuple[float, float] | None,
) -> Float[Array, "T 4"]:  # fmt: skip
    """Weights of the frames in the measurements of rotation: sum 1 for each neutral stance.

    Columns: the angles near rest, then lean forward, lean to the left and turn. `neutral` are the
    first and last second of the first stance, None: no stance. Attempts are told by the tracked
    `joints` in the head frame: how head and spine share a turn is badly known. Raises InputError
    where the first stance has no detections.
    """
    weights = np.zeros((len(times), 4))
    first = _first_stance(times, used, neutral)
    if not len(first):
        return weights
    tangents, height = stance(joints)
    frame_s = max(float(np.ptp(times)) / max(len(times) - 1, 1), 1e-3)
    frames = max(1, round(_SMOOTH_S / frame_s))
    tangents = median_filter(tangents, (frames, 1), mode="nearest")
    near = np.abs(tangents - np.median(tangents[first], axis=0)) < np.tan(RETURNED)
    upright = height > UPRIGHT * np.median(height[first])
    near[:, 0] &= upright
    weights[first] += 1.0 / len(first)
    for start, end in _attempts(times, near, used > 0):
        if start <= first[-1]:
            continue
        rows = np.linspace(start, end - 1, NEUTRAL_FRAMES + 2)[1:-1]
        rows = np.unique(rows.round().astype(int))
        stands = near[start].all()
        share = np.append(stands, near[start] * (1.0 if stands else MOVE_WEIGHT))
        weights[rows] += share / len(rows)
    return weights


def _first_stance(
    times: Float[Array, "T"], used: Int[Array, "T"], neutral: tuple[float, float] | None
) -> Int[Array, "F"]:
    """Frames of the first neutral stance, evenly spread."""
    if neutral is None:
        return np.array([], int)
    first, last = neutral
    since = times - times[0]
    inside = np.flatnonzero((since >= first) & (since <= last) & (used > 0))
    if not len(inside):
        raise InputError(f"no detections from {first} to {last} s, the neutral stance",
                         valid=f"seconds of the footage, 0 to {since[-1]:.1f}")  # fmt: skip
    rows = np.linspace(0, len(inside) - 1, min(NEUTRAL_FRAMES, len(inside)))
    return inside[rows.round().astype(int)]


def _attempts(
    times: Float[Array, "T"], near: Bool[Array, "T 3"], able: Bool[Array, "T"]
) -> Iterator[tuple[int, int]]:
    """First frame of each attempt and the one after its last: `near` stays as it is.

    Shorter stretches are passed through; stretches alike on both sides of one are one attempt.
    """
    code = np.where(able, near @ [1, 2, 4], 0)
    edges = np.r_[0, np.flatnonzero(np.diff(code)) + 1, len(code)]
    held = [(int(a), int(b)) for a, b in pairwise(edges)
            if code[a] and times[b - 1] - times[a] >= HELD_S]  # fmt: skip
    while held:
        start, end = held.pop(0)
        while held and code[held[0][0]] == code[start] and times[held[0][0]] - times[end] < HELD_S:
            end = held.pop(0)[1]
        yield start, end


def stance(joints: Float[Array, "T 18 3"]) -> tuple[Float[Array, "T 3"], Float[Array, "T"]]:
    """How the body stands to the head, and the height of its mass above its support [m].

    Tangents of its lean forward and to the left against the head's vertical, and of its turn
    against the gaze.
    """
    line, across = (np.einsum("l,tli->ti", weights, joints) for weights in (WEIGHTS, ACROSS))
    tangents = np.concatenate([line[:, :2] / line[:, 2:], across[:, :1] / across[:, 1:2]], 1)
    return tangents, line[:, 2]


def attitude(
    components: Float[Array, "K"], poses: Float[Array, "T 37"]
) -> tuple[Float[Array, "T 3"], Float[Array, "T 3 37"], Float[Array, "T 3 K"]]:
    """Lean and turn of `stance`, and their derivatives by angles and components."""
    joints, *derivatives = joint_derivatives(components, poses)
    off, _ = stance(joints)
    lengths = np.stack([(WEIGHTS @ joints)[:, 2]] * 2 + [(ACROSS @ joints)[:, 1]], 1)

    def slope(by: Array) -> Array:
        line, across = (np.einsum("l,tlid->tid", weights, by) for weights in (WEIGHTS, ACROSS))
        rise = np.concatenate([line[:, :2], across[:, :1]], 1)
        run = np.stack([line[:, 2], line[:, 2], across[:, 1]], 1)
        return (rise - off[..., None] * run) / lengths[..., None]

    by_angle, by_body = map(slope, derivatives)
    return off, by_angle, by_body


def _weights() -> Float[Array, "18"]:
    """Centre of mass minus centre of pressure, as weights of the labels; they sum to 0."""
    weights = np.zeros(len(LABEL_INDEX))
    for name, label in LABEL_INDEX.items():
        kind = name.rpartition("_")[2]
        share = _MASSES.get(kind, 0.0)
        weights[label] = share if name == "head" else share / 2
    weights /= weights.sum()
    for side in ("left", "right"):
        weights[LABEL_INDEX[f"{side}_ankle"]] -= 0.5 * (1.0 - SUPPORT)
        weights[LABEL_INDEX[f"{side}_foot"]] -= 0.5 * SUPPORT
    return weights


def _across() -> Float[Array, "18"]:
    """Sum of the lines of `_PAIRS` from right to left, as weights of the labels."""
    weights = np.zeros(len(LABEL_INDEX))
    for kind in _PAIRS:
        weights[LABEL_INDEX[f"left_{kind}"]], weights[LABEL_INDEX[f"right_{kind}"]] = 1.0, -1.0
    return weights


WEIGHTS: Float[Array, "18"] = _weights()
ACROSS: Float[Array, "18"] = _across()
