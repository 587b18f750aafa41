"""What the contact network is given: motion of feet, knees and head in the head's heading.

Both sides have the same features, mirrored, so that one network serves both feet. Heights are above
the lowest toe of the half seconds before and after: the floor's height is not asked for.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.geometry import transform
from egocap.series import interpolate

RATE = 30.0  # Hz, at which features are sampled
OFFSETS = np.arange(-10, 11, 2)
"""Samples around a frame whose features are given together."""
_HALF_S = 15  # samples
_PARTS = ("foot", "ankle", "knee")
_SIDES = ("left", "right")
_LARGEST = 5.0


def sample_times(times: Float[Array, "T"]) -> Float[Array, "N"]:
    """Times at `RATE` from the first frame's to the last one's, at least two."""
    return times[0] + np.arange(max(2, round((times[-1] - times[0]) * RATE) + 1)) / RATE


def contact_features(
    times: Float[Array, "T"], joints_head: Float[Array, "T 18 3"],
    sigma: Float[Array, "T 18"], T_world_head: Float[Array, "T 4 4"],
) -> Float[Array, "N 2 F"]:  # fmt: skip
    """Features of left and right foot at `sample_times`; `sigma` [m] are the joints' deviations."""
    at = sample_times(times)
    world = interpolate(at, times, transform(T_world_head, joints_head))
    head, forward = (interpolate(at, times, T_world_head[:, :3, i]) for i in (3, 0))
    heading = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    toes = world[:, [LABEL_INDEX["left_foot"], LABEL_INDEX["right_foot"]], 2].min(1)
    floor = _around(toes).min(1)
    deviation = np.log(np.maximum(interpolate(at, times, sigma), 1e-4))
    own = _head(head, heading, floor)
    sides = []
    for side, sign in zip(_SIDES, (1.0, -1.0), strict=True):
        ordered = (side, _SIDES[1 - _SIDES.index(side)])
        legs = [_leg(leg, sign, world, head, heading, floor, deviation) for leg in ordered]
        mirrored = own * [1.0, sign, 1.0, 1.0, sign, 1.0]
        sides.append(_in_windows(np.concatenate([*legs, mirrored], 1)))
    return np.stack(sides, 1)


def _leg(
    side: str, sign: float, world: Float[Array, "N 18 3"], head: Float[Array, "N 3"],
    heading: Float[Array, "N"], floor: Float[Array, "N"], deviation: Float[Array, "N 18"],
) -> Float[Array, "N K"]:  # fmt: skip
    """Velocities, places from the head, and heights of a leg's joints; toe's and ankle's spread."""
    mirror = np.array([1.0, sign, 1.0])
    columns = []
    for part in _PARTS:
        x = world[:, LABEL_INDEX[f"{side}_{part}"]]
        v, r = mirror * _level(_velocity(x), heading), mirror * _level(x - head, heading)
        columns += [v, np.hypot(v[:, :1], v[:, 1:2]), r[:, :2]]
        if part != "knee":
            columns.append((x[:, 2] - floor)[:, None])
    columns += [deviation[:, [LABEL_INDEX[f"{side}_foot"], LABEL_INDEX[f"{side}_ankle"]]]]
    return np.concatenate(columns, 1)


def _head(
    head: Float[Array, "N 3"], heading: Float[Array, "N"], floor: Float[Array, "N"]
) -> Float[Array, "N 6"]:
    """The head's velocity, height about its mean, turning, and height above the floor."""
    v = _level(_velocity(head), heading)
    bob = head[:, 2] - _around(head[:, 2], "edge").mean(1)
    return np.stack(
        [v[:, 0], v[:, 1], v[:, 2], bob, np.gradient(heading, 1 / RATE), head[:, 2] - floor - 1.5],
        1,
    )  # fmt: skip


def _velocity(x: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    return np.asarray(np.gradient(x, 1 / RATE, axis=0))


def _level(v: Float[Array, "N 3"], heading: Float[Array, "N"]) -> Float[Array, "N 3"]:
    """Vectors of the world in axes that are forward, left and up for the head."""
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([cos * v[:, 0] + sin * v[:, 1], cos * v[:, 1] - sin * v[:, 0], v[:, 2]], axis=1)


def _around(values: Float[Array, "N"], mode: str = "edge") -> Float[Array, "N W"]:
    """Each sample with those of half a second before and after."""
    padded = np.pad(values, _HALF_S, mode=mode)  # type: ignore[call-overload]
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * _HALF_S + 1)


def _in_windows(features: Float[Array, "N K"]) -> Float[Array, "N F"]:
    reach = int(OFFSETS.max())
    padded = np.pad(np.clip(features, -_LARGEST, _LARGEST), ((reach, reach), (0, 0)), mode="edge")
    return np.concatenate([padded[reach + o : reach + o + len(features)] for o in OFFSETS], 1)
