"""Edit canonical clips: cut, mirror, change the speed, and join them without a seam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation, Slerp

from egocap.errors import InputError
from egocap.series import interpolate
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.clips.cleaning import to_local, with_local_rotations
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import minimum_jerk, turn
from egocap_sim.motion.kinematics.limbs import solve_limbs

_SHORTEST_S = 0.25
BLEND = 0.6  # seconds of the transition from the end pose of one clip to the next clip
_LEGS = [[INDEX[f"{s}_{part}"] for part in ("thigh", "calf", "foot")] for s in ("l", "r")]
_MIRROR = np.diag([1.0, -1.0, 1.0])
_OTHER_SIDE = [INDEX[{"l_": "r_", "r_": "l_"}.get(b[:2], b[:2]) + b[2:]] for b in BODIES]


def trim(clip: Clip, start_s: float, length_s: float) -> Clip:
    """Part of a clip. Raises InputError where it begins too near the end."""
    first = round(start_s * clip.fps)
    last = min(first + int(np.ceil(length_s * clip.fps)) + 1, len(clip.positions))
    if (last - 1 - first) / clip.fps < _SHORTEST_S:
        seconds = (len(clip.positions) - 1) / clip.fps - _SHORTEST_S
        raise InputError(
            f"{start_s:g} s is beyond the end of {clip.name}", valid=f"less than {seconds:.2f} s"
        )
    return replace(clip, positions=clip.positions[first:last], rotations=clip.rotations[first:last])


def mirror(clip: Clip) -> Clip:
    """Left and right exchanged, across the plane y = 0."""
    return replace(
        clip,
        name=f"{clip.name} mirrored",
        positions=clip.positions[:, _OTHER_SIDE] @ _MIRROR,
        rotations=_MIRROR @ clip.rotations[:, _OTHER_SIDE] @ _MIRROR,
    )


def change_speed(clip: Clip, speed: float) -> Clip:
    """The same motion, faster by a factor."""
    return replace(clip, fps=clip.fps * speed)


def join_clips(clip: Clip, other: Clip) -> Clip:
    """Join two clips with a smooth transition and fixed feet."""
    other = _at_rate(fit_to_figure(other), clip.fps)
    return concatenate(f"{clip.name} then {other.name}", [fit_to_figure(clip), other])


def fit_to_figure(clip: Clip) -> Clip:
    """A clip's rotations on the standard figure, with the hip height scaled by leg length."""
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


def _at_rate(clip: Clip, fps: float) -> Clip:
    """Resample a clip on the figure: rotations by slerp, the pelvis linearly."""
    if clip.fps == fps:
        return clip
    keys = np.arange(len(clip.positions)) / clip.fps
    times = np.arange(int(keys[-1] * fps + 1e-6) + 1) / fps
    times = np.minimum(times, keys[-1])
    rotations = np.stack(
        [Slerp(keys, Rotation.from_matrix(clip.rotations[:, b]))(times).as_matrix()
         for b in range(len(BODIES))], 1)  # fmt: skip
    pelvis = interpolate(times, keys, clip.positions[:, 0])
    return Clip(clip.name, fps, figure.positions(rotations, pelvis), rotations, canonical=True)


def concatenate(name: str, clips: Sequence[Clip]) -> Clip:
    """Join canonical clips of the same frame rate into one.

    Each clip is moved so that its first feet match the last ones of its predecessor; the remaining
    difference between the poses fades out over `BLEND`.
    """
    assert clips and all(c.canonical and c.fps == clips[0].fps for c in clips)
    joined = clips[0]
    for clip in clips[1:]:
        clip = _blend_from_end(_align_to_end(clip, joined), joined)
        joined = replace(
            joined,
            positions=np.concatenate([joined.positions, clip.positions[1:]]),
            rotations=np.concatenate([joined.rotations, clip.rotations[1:]]),
        )
    return replace(joined, name=name)


def _stand(clip: Clip, t: int) -> tuple[Float[Array, "2"], float]:
    """Middle between the ankles, and the heading of the feet."""
    feet = [INDEX["l_foot"], INDEX["r_foot"]]
    ahead = clip.rotations[t, feet, :2, 0].sum(0)
    return clip.positions[t, feet, :2].mean(0), float(np.arctan2(ahead[1], ahead[0]))


def _align_to_end(clip: Clip, before: Clip) -> Clip:
    (here, yaw), (there, wanted) = _stand(clip, 0), _stand(before, -1)
    R = turn(yaw=wanted - yaw)
    shift = np.array([*there, 0.0]) - R @ np.array([*here, 0.0])
    return replace(clip, positions=clip.positions @ R.T + shift, rotations=R @ clip.rotations)


def _blend_from_end(clip: Clip, before: Clip) -> Clip:
    """Fade out the pose difference at the seam; the legs follow the feet."""
    T = len(clip.positions)
    fade = 1.0 - minimum_jerk(np.arange(T) / (BLEND * clip.fps))
    local = to_local(clip.rotations)
    last = to_local(before.rotations[-1:])[0]
    difference = Rotation.from_matrix(last @ np.swapaxes(local[0], -1, -2)).as_rotvec()
    upper = [b for b in range(len(difference)) if b < INDEX["l_thigh"]]
    for b in upper:
        local[:, b] = Rotation.from_rotvec(fade[:, None] * difference[b]).as_matrix() @ local[:, b]
    moved = fade[:, None] * (before.positions[-1, 0] - clip.positions[0, 0])
    posed = with_local_rotations(clip, local)
    posed = replace(posed, positions=posed.positions + moved[:, None])
    return _solve_legs(posed, _hold_feet(clip, before, fade))


def _hold_feet(clip: Clip, before: Clip, fade: Float[Array, "T"]) -> Clip:
    """The clip with each foot at its previous place until its first step, no faster than `fade`.

    The thighs fade from their previous rotation: they give the direction in which the knees bend.
    """
    p, R = clip.positions.copy(), clip.rotations.copy()
    for s in ("l_", "r_"):
        thigh, foot, toe = (INDEX[s + part] for part in ("thigh", "foot", "toe"))
        away = np.linalg.norm(p[:, foot] - p[0, foot], axis=1)
        stays = np.maximum(fade, 1.0 - minimum_jerk(np.maximum.accumulate(away) / 0.2))
        p[:, foot] += stays[:, None] * (before.positions[-1, foot] - clip.positions[0, foot])
        for body, bodies, share in ((thigh, [thigh], fade), (foot, [foot, toe], stays)):
            turned = Rotation.from_matrix(before.rotations[-1, body] @ clip.rotations[0, body].T)
            back = Rotation.from_rotvec(share[:, None] * turned.as_rotvec()).as_matrix()
            R[:, bodies] = back[:, None] @ R[:, bodies]
    return replace(clip, positions=p, rotations=R)


def _solve_legs(clip: Clip, wanted: Clip) -> Clip:
    """Bend the legs to the foot poses of another clip."""
    R = clip.rotations.copy()
    for s in ("l_", "r_"):
        thigh, calf, foot, toe = (INDEX[s + part] for part in ("thigh", "calf", "foot", "toe"))
        forward = wanted.rotations[:, thigh, :, 0]
        R[:, thigh], R[:, calf] = solve_limbs(
            clip.positions[:, thigh], wanted.positions[:, foot], forward,
            figure.THIGH, figure.CALF, knee=True,
        )  # fmt: skip
        R[:, foot], R[:, toe] = wanted.rotations[:, foot], wanted.rotations[:, toe]
    return replace(clip, rotations=R, positions=figure.positions(R, clip.positions[:, 0]))
