"""Find recorded clips of different sets that are the same take.

One take is found in several collections, on other skeletons, trimmed or mirrored. Clips are
compared by the directions of their limbs relative to the pelvis. Each limb's directions of one clip
are rotated onto those of the other, since rest poses differ; what agrees then is correlation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.commandline import progress
from egocap.errors import EgocapError
from egocap.evaluation.table import Table
from egocap.files import disk_errors, make_folder
from egocap.geometry import unit
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import SETS, motion_sets, split_clips
from egocap_sim.core.bodies import INDEX

SAME = 0.95
"""Correlation from which two clips count as one take. Two conversions of one take have 0.955 to
0.998. Different takes of one subject's walk reach it too; they should be in one set anyway."""
RATE = 15.0  # samples/s
LEAST_S, LEAST_SHARE = 1.3, 0.8  # overlap of two clips, seconds and share of the shorter
LIMBS = tuple(
    (side + upper, side + lower)
    for side in ("l_", "r_")
    for upper, lower in (("upperarm", "forearm"), ("forearm", "hand"), ("thigh", "calf"),
                         ("calf", "foot"))
)  # fmt: skip
_MIRROR = (4, 5, 6, 7, 0, 1, 2, 3)

Directions = Float[Array, "T 8 3"]
"""Unit vectors along the limbs in the pelvis's frame (x forward, y left)."""


@dataclass(frozen=True)
class Match:
    """Two clips of different sets that may be one take."""

    first: str
    second: str
    correlation: float
    mirrored: bool


def study(
    motions: Annotated[Path, arg(metavar="DIR")],
    link: Annotated[Path | None, arg(metavar="DIR")] = None,
) -> Outcome:
    """List the sets of a folder of clips; exit code 3 if clips of two sets are the same take.

    Args:
        motions: Folder of motion clips.
        link: Make links to the training and the validation clips, in two folders in this one, for
            `egocap-sim generate --motions`.
    """
    split = split_clips(motions)
    found, unread = {}, {}
    paths = [(name, path) for name in SETS for path in split[name]]
    with progress("clips", len(paths), unit="clips") as advance:
        for name, path in paths:
            advance()
            try:
                found[path.name] = (name, read_directions(path))
            except EgocapError as error:
                unread[path.name] = str(error)
    matches = list(matching(found))
    if link is not None:
        for name in ("training", "validation"):
            link_clips(split[name], motions, link / name)
    result: dict[str, Any] = {
        "clips": {name: [path.name for path in split[name]] for name in SETS},
        "excluded": dict(motion_sets().excluded), "unread": unread,
        "matches": [vars(match) for match in matches],
    }  # fmt: skip
    rows = tuple((name, str(len(split[name]))) for name in SETS)
    missed = [f"{m.first} and {m.second} are one take (correlation {m.correlation:.3f})"
              for m in matches]  # fmt: skip
    return Outcome(result, [Table("", ("set", "clips"), rows)], missed)


def link_clips(clips: Sequence[Path], folder: Path, out: Path) -> None:
    """Make links to clips of a folder at the same places in another one."""
    for path in clips:
        place = out / path.relative_to(folder)
        make_folder(place.parent)
        with disk_errors(place):
            place.unlink(missing_ok=True)
            place.symlink_to(path.resolve())


def matching(clips: Mapping[str, tuple[str, Directions]]) -> Iterator[Match]:
    """Pairs of clips of different sets that count as one take; clips by name, with their set."""
    pairs = [(a, b) for a, b in combinations(clips, 2) if clips[a][0] != clips[b][0]]
    with progress("pairs", len(pairs), unit="pairs") as advance:
        for a, b in pairs:
            advance()
            first, second = clips[a][1], clips[b][1]
            found = {m: correlation(first, mirrored(second) if m else second)
                     for m in (False, True)}  # fmt: skip
            best = max(found, key=lambda m: found[m])
            if found[best] >= SAME:
                yield Match(a, b, round(found[best], 3), best)


def read_directions(path: Path) -> Directions:
    """The limbs' directions of a clip, `RATE` a second. Raises FileError."""
    from egocap_sim.motion.clips.load import load_clip

    clip = load_clip(path)
    rows = np.arange(0, len(clip.positions) - 1, clip.fps / RATE).round().astype(int)
    return limb_directions(clip.positions[rows])


def limb_directions(positions: Float[Array, "T 21 3"]) -> Directions:
    """The limbs' directions of bodies in the order of `egocap_sim.core.bodies.BODIES`."""

    def at(body: str) -> Array:
        return positions[:, INDEX[body]]

    left = unit(at("l_thigh") - at("r_thigh"))
    forward = unit(np.cross(left, at("neck") - at("pelvis")))
    axes = np.stack([forward, left, np.cross(forward, left)], axis=1)
    limbs = np.stack([unit(at(lower) - at(upper)) for upper, lower in LIMBS], axis=1)
    return np.einsum("tij,tbj->tbi", axes, limbs)


def mirrored(limbs: Directions) -> Directions:
    """The directions with left and right exchanged."""
    return limbs[:, _MIRROR] * np.array([1.0, -1.0, 1.0])


def correlation(first: Directions, second: Directions) -> float:
    """Correlation of two clips at the lag where they agree best; 0 for too short an overlap."""
    if len(first) > len(second):
        first, second = second, first
    least = max(round(LEAST_S * RATE), round(LEAST_SHARE * len(first)))
    lags = range(least - len(first), len(second) - least + 1)
    if len(first) < least:
        return 0.0
    cosines = np.einsum("tbi,sbi->ts", first, second) / len(LIMBS)
    best = max(lags, key=lambda lag: np.diagonal(cosines, lag).mean())
    near = [lag for lag in range(best - 2, best + 3) if lag in lags]
    return max(_rotated_correlation(*_overlap(first, second, lag)) for lag in near)


def _overlap(first: Directions, second: Directions, lag: int) -> tuple[Directions, Directions]:
    start = max(0, -lag)
    count = min(len(first) - start, len(second) - start - lag)
    return first[start : start + count], second[start + lag : start + lag + count]


def _rotated_correlation(first: Directions, second: Directions) -> float:
    """Correlation of deviations from the mean, each limb rotated to agree best (Kabsch)."""
    a, b = first - first.mean(0), second - second.mean(0)
    u, s, vh = np.linalg.svd(np.einsum("tbi,tbj->bij", a, b))
    sign = np.sign(np.linalg.det(u @ vh))
    shared = s[:, 0] + s[:, 1] + sign * s[:, 2]
    return float(2.0 * shared.sum() / max((a**2).sum() + (b**2).sum(), 1e-12))
