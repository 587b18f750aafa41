"""Variants of a canonical clip: a part of it, mirrored, faster or slower, passing into another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from egocap.errors import InputError
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.clips.concatenation import concatenate
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip

_SHORTEST_S = 0.25
_MIRROR = np.diag([1.0, -1.0, 1.0])
_OTHER_SIDE = [INDEX[{"l_": "r_", "r_": "l_"}.get(b[:2], b[:2]) + b[2:]] for b in BODIES]


def shortened(clip: Clip, start_s: float, length_s: float) -> Clip:
    """Part of a clip. Raises InputError where it begins too near the end."""
    first = round(start_s * clip.fps)
    last = min(first + int(np.ceil(length_s * clip.fps)) + 1, len(clip.positions))
    if (last - 1 - first) / clip.fps < _SHORTEST_S:
        seconds = (len(clip.positions) - 1) / clip.fps - _SHORTEST_S
        raise InputError(
            f"{start_s:g} s is beyond the end of {clip.name}", valid=f"less than {seconds:.2f} s"
        )
    return replace(clip, positions=clip.positions[first:last], rotations=clip.rotations[first:last])


def mirrored(clip: Clip) -> Clip:
    """Left and right exchanged, across the plane y = 0."""
    return replace(
        clip,
        name=f"{clip.name} mirrored",
        positions=clip.positions[:, _OTHER_SIDE] @ _MIRROR,
        rotations=_MIRROR @ clip.rotations[:, _OTHER_SIDE] @ _MIRROR,
    )


def hurried(clip: Clip, speed: float) -> Clip:
    """The same motion in 1 / speed of its time."""
    return replace(clip, fps=clip.fps * speed)


def joined(clip: Clip, other: Clip) -> Clip:
    """A clip that passes into another: its feet stay where they are, the rest changes smoothly."""
    other = _at_rate(on_figure(other), clip.fps)
    return concatenate(f"{clip.name} then {other.name}", [on_figure(clip), other])


def on_figure(clip: Clip) -> Clip:
    """A clip's rotations on the standard figure, its hips as high for its legs as they were."""
    thighs = [INDEX["l_thigh"], INDEX["r_thigh"]]
    legs = [
        np.linalg.norm(np.diff(clip.positions[:, leg], axis=1), axis=-1).mean(0).sum()
        for leg in _LEGS
    ]
    scale = (figure.THIGH + figure.CALF) / float(np.mean(legs))
    hips = scale * clip.positions[:, thighs].mean(1)
    offset = (figure.REST[thighs] - figure.REST[0]).mean(0)
    pelvis = hips - clip.rotations[:, 0] @ offset
    return replace(clip, positions=figure.positions(clip.rotations, pelvis))


_LEGS = [[INDEX[f"{s}_{part}"] for part in ("thigh", "calf", "foot")] for s in ("l", "r")]


def _at_rate(clip: Clip, fps: float) -> Clip:
    """A clip on the figure, sampled at another rate: rotations slerped, hips straight between."""
    from scipy.spatial.transform import Rotation, Slerp

    if clip.fps == fps:
        return clip
    keys = np.arange(len(clip.positions)) / clip.fps
    times = np.arange(int(keys[-1] * fps + 1e-6) + 1) / fps
    times = np.minimum(times, keys[-1])
    rotations = np.stack(
        [Slerp(keys, Rotation.from_matrix(clip.rotations[:, b]))(times).as_matrix()
         for b in range(len(BODIES))], 1)  # fmt: skip
    pelvis = np.stack([np.interp(times, keys, clip.positions[:, 0, a]) for a in range(3)], 1)
    return Clip(clip.name, fps, figure.positions(rotations, pelvis), rotations, canonical=True)
