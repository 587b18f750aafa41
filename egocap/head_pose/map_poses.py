"""Poses in a map of points; those of a recording's parts, joined where the parts overlap.

Each part of a long recording has a map of its own, so that memory grows with the length of a part
alone, and time with that of the recording. Loops are closed within a part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.geometry import rigid, skew, transform
from egocap.head_pose.floor import Pictured
from egocap.odometry.views import Views

FEWEST_SHARED = 15  # poses that two parts have in common
APART = "in another part of the recording, which nothing joins to this one"


@dataclass(frozen=True, eq=False)
class MapPoses:
    """Poses of the frames that have one, in the frame of a map of points, metres."""

    frame: Int[Array, "N"]  # numbers of the sequence
    time: Float[Array, "N"]  # s
    T_map_head: Float[Array, "N 4 4"]
    covariance: Float[Array, "N 6 6"] | None  # of rotation (head frame) and position
    points: Float[Array, "P 3"]
    views: Views  # in which the pictures were seen
    facts: dict[str, Any]  # how they were found, JSON-ready
    reasons: dict[int, str]  # why other frames have none
    pictures: dict[int, Pictured]  # of some frames spread over the sequence
    rig_covariance: Float[Array, "Q Q"] | None = None
    """What is unknown of the rig, as in `RigSearch`; None: it is taken as exact."""


def overlapping(frames: int, longest: int, overlap: int) -> list[range]:
    """Ranges of frames, one or an even number, none much shorter than the others."""
    if frames <= longest + overlap:
        return [range(frames)]
    count = -(-(frames - overlap) // (longest - overlap))
    count += count % 2  # two cores end together
    starts = np.linspace(0, frames - overlap, count + 1).round().astype(int).tolist()
    return [range(a, b + overlap) for a, b in pairwise(starts)]


def joined_parts(parts: Sequence[MapPoses]) -> MapPoses:
    """The poses of parts by odometry, in order, in the frame of the first one's map.

    Parts with too few poses in common are not joined; the longest of what results is kept.
    """
    chains = [parts[0]]
    for part in parts[1:]:
        together = _joined(chains[-1], part)
        chains[-1:] = [chains[-1], part] if together is None else [together]
    kept = max(chains, key=lambda chain: len(chain.frame))
    reasons: dict[int, str] = {}
    for chain in chains:
        reasons |= chain.reasons
        reasons |= {} if chain is kept else dict.fromkeys(chain.frame.tolist(), APART)
    return replace(kept, reasons=reasons)


def _joined(first: MapPoses, second: MapPoses) -> MapPoses | None:
    """Both in the first one's frame; None where they have too few poses in common.

    Where both have poses, these pass from the first one's to the second one's.
    """
    assert first.covariance is not None and second.covariance is not None
    _, i, k = np.intersect1d(first.frame, second.frame, return_indices=True)
    if len(i) < FEWEST_SHARED:
        return None
    T = _mean_transform(first.T_map_head[i], second.T_map_head[k])
    moved, middle = T @ second.T_map_head, len(i) // 2
    carried = _carried(
        first.covariance[i[middle]], first.T_map_head[i[middle]],
        turned(second.covariance, T), moved,
    )  # fmt: skip
    poses, covariance = first.T_map_head.copy(), first.covariance.copy()
    poses[i] = _between(poses[i], moved[k], (np.arange(len(i)) + 0.5) / len(i))
    covariance[i[middle:]] = carried[k[middle:]]
    own = ~np.isin(second.frame, first.frame)
    order = np.argsort(np.concatenate([first.frame, second.frame[own]]))

    def both(a: Array, b: Array) -> Array:
        return np.concatenate([a, b[own]])[order]

    return replace(
        first,
        frame=both(first.frame, second.frame), time=both(first.time, second.time),
        T_map_head=both(poses, moved), covariance=both(covariance, carried),
        points=np.concatenate([first.points, transform(T, second.points)]),
        facts=_facts(first.facts, second.facts), reasons=first.reasons | second.reasons,
        pictures=first.pictures | second.pictures,
    )  # fmt: skip


def turned(covariance: Float[Array, "N 6 6"], T: Float[Array, "4 4"]) -> Float[Array, "N 6 6"]:
    """Covariances with the position in another frame."""
    A = np.eye(6)
    A[3:, 3:] = T[:3, :3]
    return A @ covariance @ A.T


def _mean_transform(a: Float[Array, "n 4 4"], b: Float[Array, "n 4 4"]) -> Float[Array, "4 4"]:
    """T of which T b is nearest to a in rotation, and then in the mean place."""
    R = Rotation.from_matrix(a[:, :3, :3] @ b[:, :3, :3].transpose(0, 2, 1)).mean().as_matrix()
    return rigid(R, a[:, :3, 3].mean(0) - R @ b[:, :3, 3].mean(0))


def _between(
    a: Float[Array, "n 4 4"], b: Float[Array, "n 4 4"], share: Float[Array, "n"]
) -> Float[Array, "n 4 4"]:
    """Poses at shares of the way from a to b, each by one turn and straight."""
    first = Rotation.from_matrix(a[:, :3, :3])
    turn = (first.inv() * Rotation.from_matrix(b[:, :3, :3])).as_rotvec()
    R = (first * Rotation.from_rotvec(share[:, None] * turn)).as_matrix()
    return rigid(R, a[:, :3, 3] + share[:, None] * (b[:, :3, 3] - a[:, :3, 3]))


def _carried(
    covariance: Float[Array, "6 6"], joint: Float[Array, "4 4"], own: Float[Array, "N 6 6"],
    poses: Float[Array, "N 4 4"],
) -> Float[Array, "N 6 6"]:  # fmt: skip
    """Covariances of poses after a joint: their own, and what the joint's pose adds."""
    J = np.zeros((len(poses), 6, 6))
    J[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1) @ joint[:3, :3]
    J[:, 3:, :3] = -skew(poses[:, :3, 3] - joint[:3, 3]) @ joint[:3, :3]
    J[:, 3:, 3:] = np.eye(3)
    return own + J @ covariance @ J.transpose(0, 2, 1)


def _facts(a: dict[str, Any], b: dict[str, Any]) -> dict[str, Any]:
    """Facts of two parts: counts added up; the noise is the mean by keyframes."""
    counts = {name: a[name] + b[name] for name in ("parts", "keyframes", "points", "joined",
                                                   "loops")}  # fmt: skip
    noise = a["noise_factor"] * a["keyframes"] + b["noise_factor"] * b["keyframes"]
    return a | counts | {"segments": a["segments"] + b["segments"] - 1,
                         "noise_factor": round(noise / counts["keyframes"], 3)}  # fmt: skip
