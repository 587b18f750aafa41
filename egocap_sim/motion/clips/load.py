"""Load a motion file as a canonical clip: recognise skeleton, up axis and unit, clean, calibrate.

Accepts BVH with joint names of `skeleton_names.CONVENTIONS` or a name map, npz as in
`npz.read_npz_clip`, and any frame rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import FileError, InputError
from egocap.geometry import unit
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.clips.anatomy import raise_head, reversed_hinges, straighten
from egocap_sim.motion.clips.bone_calibration import Hints, bone_frames, calibrate, canonical
from egocap_sim.motion.clips.bvh import Bvh, pose, read_bvh
from egocap_sim.motion.clips.cleaning import (
    despike,
    longest_take,
    put_on_floor,
    repair_beyond_limits,
)
from egocap_sim.motion.clips.clip_check import ClipReport, check_clip
from egocap_sim.motion.clips.npz import read_npz_clip
from egocap_sim.motion.clips.skeleton_names import map_joints, normal, read_name_map
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.figure import leg_length

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048, "cmu": 0.0254 / 0.45}
"""Metres per file unit; 'cmu' is the unit of the CMU database's skeletons (0.45 per inch)."""
LEG = (0.55, 1.15)  # metres from hip to ankle of a person, to infer the unit
PLAUSIBLE_LEG = (0.2, 3.0)  # metres; outside, a given unit or that of an npz file is wrong
UP_AXES = ("y", "z")
"""Valid up axes; inferred from the position of the head."""

_TO_Z_UP = {
    "y": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),  # facing +z becomes +x
    "z": np.eye(3),
}


@dataclass(frozen=True, eq=False)
class LoadedMotion:
    """A motion file: the clip to use, the clip as recorded, and what is wrong with it."""

    clip: Clip  # cleaned
    raw: Clip  # canonical and on the floor like `clip`, nothing else repaired
    report: ClipReport


def load_clip(
    path: str | Path,
    *,
    up: str | None = None,
    unit: str | float | None = None,
    names: str | Path | Mapping[str, str] | None = None,
) -> Clip:
    """Read a .bvh or .npz motion as a canonical `Clip` (metres, z up, floor near z = 0).

    `up` is 'y' or 'z', `unit` a name of `UNITS` or metres per file unit, `names` a map
    body -> joint or a TOML file of it; what is not given is inferred from the file. Raises
    FileError for an invalid file, InputError for invalid options.
    """
    return load_motion(path, up=up, unit=unit, names=names).clip


def load_motion(
    path: str | Path,
    *,
    up: str | None = None,
    unit: str | float | None = None,
    names: str | Path | Mapping[str, str] | None = None,
) -> LoadedMotion:
    """Read a motion file like `load_clip`, with the recorded motion and the check of both."""
    path = Path(path)
    _check_options(up, unit)
    if path.is_dir():
        raise FileError(path, "is a folder", valid="a .bvh or .npz file")
    kind = path.suffix.lower()
    if kind == ".npz":
        positions, rotations, fps = read_npz_clip(path)
        clip, hints = Clip(path.stem, fps, positions, rotations), {}
    elif kind == ".bvh":
        given = names if isinstance(names, Mapping) or names is None else read_name_map(names)
        clip, hints = _from_bvh(read_bvh(path), path, up, unit, given)
    else:
        raise FileError(path, f"is of an unknown kind '{kind}'", valid=".bvh, .npz")
    leg = leg_length(clip.positions)
    if not PLAUSIBLE_LEG[0] < leg < PLAUSIBLE_LEG[1]:
        wrong = "positions are in metres" if kind == ".npz" else f"unit={'|'.join(UNITS)}"
        raise FileError(path, f"the person's legs are {leg:.3g} m long", valid=wrong)
    try:
        return clean(clip, hints)
    except InputError as e:
        raise FileError(path, str(e)) from e


def clean(clip: Clip, hints: Hints | None = None) -> LoadedMotion:
    """Trim, despike, calibrate, enforce anatomy and put on the floor; check what that changed."""
    hints = hints or {}
    take, trimmed = longest_take(clip)
    smooth, _ = despike(take)
    K = bone_frames(smooth, hints)
    raw, posed = canonical(take, K), canonical(smooth, K)
    hinges = reversed_hinges(posed)
    cleaned = posed
    if hinges:
        for hinge in hinges:
            cleaned = straighten(replace(cleaned, canonical=True), hinge)
        turned = {b: {k: K[INDEX[b]].T @ v for k, v in of.items()} for b, of in hints.items()}
        cleaned = calibrate(cleaned, turned)
    cleaned, _ = repair_beyond_limits(raise_head(cleaned))
    cleaned, shift = put_on_floor(cleaned)
    raw = replace(raw, positions=raw.positions + [0.0, 0.0, shift])
    return LoadedMotion(cleaned, raw, check_clip(raw, posed, cleaned, trimmed, hinges, shift))


def _check_options(up: str | None, unit: str | float | None) -> None:
    if up is not None and up not in UP_AXES:
        raise InputError(f"up axis '{up}'", valid=UP_AXES)
    number = isinstance(unit, int | float) and not isinstance(unit, bool)
    if unit is not None and not (unit in UNITS or (number and 1e-6 < float(unit) < 1e3)):
        raise InputError(f"unit '{unit}'", valid=", ".join(UNITS) + " or metres per file unit")


def _from_bvh(
    bvh: Bvh,
    path: Path,
    up: str | None,
    unit: str | float | None,
    names: Mapping[str, str] | None,
) -> tuple[Clip, dict[str, dict[str, Array]]]:
    parents = [j.parent for j in bvh.joints]
    mapped = map_joints(bvh.names, parents, where=path, given=names)
    R, t = bvh.local()
    W, P = pose(tuple(parents), R, t)
    turn = _TO_Z_UP[up or _up_axis(P, bvh.rest_positions(), mapped, path)]
    metres = UNITS[unit] if isinstance(unit, str) else unit
    scale = _unit(P, mapped, path) if metres is None else metres
    W, P = turn @ W, P @ turn.T * scale
    end = {j: np.array(joint.end_site or (0, 0, 0)) * scale for j, joint in enumerate(bvh.joints)}
    positions, rotations = _bodies(mapped, W, P, end)
    return Clip(path.stem, bvh.fps, positions, rotations), _hints(bvh, parents, mapped, W, P)


def _up_axis(
    P: Float[Array, "T J 3"], rest: Float[Array, "J 3"], mapped: Mapping[str, int], path: Path
) -> str:
    """The axis along which the head is above the feet, in most frames or in the zero pose."""
    feet = [mapped["l_foot"], mapped["r_foot"]]
    for pose_, least in ((P, 0.75), (rest[None], 0.9)):
        body = unit(pose_[:, mapped["head"]] - pose_[:, feet].mean(1)).mean(0)
        axis = max((1, 2), key=lambda i: body[i])
        if body[axis] > least:
            return "xyz"[axis]
    raise FileError(path, "cannot infer the up axis: the person never stands", valid="up=y, up=z")


def _unit(P: Float[Array, "T J 3"], mapped: Mapping[str, int], path: Path) -> float:
    """Metres per file unit, from the length of the legs."""
    leg = leg_length(P, mapped)
    fits = [m for m in UNITS.values() if LEG[0] < leg * m < LEG[1]]
    if not fits:
        raise FileError(
            path,
            f"cannot infer the unit: a leg is {leg:.4g} units long",
            valid="unit=" + "|".join(UNITS),
        )
    return fits[0]


def _bodies(
    mapped: Mapping[str, int],
    W: Float[Array, "T J 3 3"],
    P: Float[Array, "T J 3"],
    end: Mapping[int, Array],
) -> tuple[Float[Array, "T 21 3"], Float[Array, "T 21 3 3"]]:
    """Positions and rotations of the 21 bodies; missing ones lie between their neighbours."""
    positions = np.zeros((len(P), len(BODIES), 3))
    rotations = np.zeros((len(P), len(BODIES), 3, 3))

    def put(body: str, p: Array, R: Array) -> None:
        positions[:, INDEX[body]], rotations[:, INDEX[body]] = p, R

    def at(body: str) -> Array:
        return positions[:, INDEX[body]]

    for body, joint in mapped.items():
        put(body, P[:, joint], W[:, joint])
    shoulders = 0.5 * (at("l_upperarm") + at("r_upperarm"))
    for body, low, high, share in (
        ("chest", "pelvis", shoulders, 0.6),
        ("spine", "pelvis", None, 0.45),
        ("neck", None, at("head"), 0.6),
    ):
        if body not in mapped:
            a = at(low) if low else 0.5 * (at("chest") + shoulders)
            b = at("chest") if high is None else high
            put(body, a + share * (b - a), rotations[:, INDEX[low or "chest"]])
    for s in ("l_", "r_"):
        if s + "clavicle" not in mapped:
            p = at("neck") + 0.2 * (at(s + "upperarm") - at("neck"))
            put(s + "clavicle", p, rotations[:, INDEX["chest"]])
        if s + "toe" not in mapped:
            R = rotations[:, INDEX[s + "foot"]]
            put(s + "toe", at(s + "foot") + R @ (0.75 * end[mapped[s + "foot"]]), R)
    return positions, rotations


_FINGERS = {"middle": ("mid",), "index": ("index",), "little": ("pinky", "little", "ring")}


def _hints(
    bvh: Bvh,
    parents: Sequence[int],
    mapped: Mapping[str, int],
    W: Float[Array, "T J 3 3"],
    P: Float[Array, "T J 3"],
) -> dict[str, dict[str, Array]]:
    """Axes of hands and head from fingers and eyes in the first frame (`calibrate`)."""

    def local(body: str, v: Array) -> Array:
        return W[0, mapped[body]].T @ v

    def child(body: str, words: Sequence[str]) -> int | None:
        for j, p in enumerate(parents):
            if p == mapped[body] and any(w in normal(bvh.names[j]) for w in words):
                return j
        return None

    hints: dict[str, dict[str, Array]] = {}
    for s in ("l_", "r_"):
        hand = s + "hand"
        finger = {k: child(hand, words) for k, words in _FINGERS.items()}
        if None in finger.values():
            continue
        at = {k: P[0, j] for k, j in finger.items()}
        hints[hand] = {
            "up": local(hand, P[0, mapped[hand]] - at["middle"]),
            "forward": local(hand, at["index"] - at["little"]),
        }
    eyes = [j for s in ("l", "r") for j, n in enumerate(bvh.names) if normal(n) in _eye(s)]
    if len(eyes) == 2:
        hints["head"] = {"left": local("head", P[0, eyes[0]] - P[0, eyes[1]])}
    return hints


def _eye(side: str) -> tuple[str, ...]:
    return (f"{side}eye", {"l": "left", "r": "right"}[side] + "eye", f"eye{side}")
