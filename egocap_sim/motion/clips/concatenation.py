"""Join canonical clips: each starts where the last one's feet ended, and differences fade out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.clips.cleaning import rebuilt, to_local
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import minimum_jerk, turn

BLEND = 0.6  # seconds over which a clip's start leaves the pose the last one ended in


def concatenate(name: str, clips: Sequence[Clip]) -> Clip:
    """One canonical clip out of several of the same frame rate.

    Each is moved so that its feet start where and as the last ones stood; what else differs
    between the last pose and its first fades out over `BLEND`.
    """
    assert clips and all(c.canonical and c.fps == clips[0].fps for c in clips)
    joined = clips[0]
    for clip in clips[1:]:
        clip = _faded(_moved(clip, joined), joined)
        joined = dataclasses.replace(
            joined,
            positions=np.concatenate([joined.positions, clip.positions[1:]]),
            rotations=np.concatenate([joined.rotations, clip.rotations[1:]]),
        )
    return dataclasses.replace(joined, name=name)


def _stand(clip: Clip, t: int) -> tuple[Float[Array, "2"], float]:
    """Middle between the ankles, and the heading of the feet."""
    feet = [INDEX["l_foot"], INDEX["r_foot"]]
    ahead = clip.rotations[t, feet, :2, 0].sum(0)
    return clip.positions[t, feet, :2].mean(0), float(np.arctan2(ahead[1], ahead[0]))


def _moved(clip: Clip, before: Clip) -> Clip:
    (here, yaw), (there, wanted) = _stand(clip, 0), _stand(before, -1)
    R = turn(yaw=wanted - yaw)
    shift = np.array([*there, 0.0]) - R @ np.array([*here, 0.0])
    return dataclasses.replace(
        clip, positions=clip.positions @ R.T + shift, rotations=R @ clip.rotations
    )


def _faded(clip: Clip, before: Clip) -> Clip:
    """Carry the difference at the seam into the clip, fading; legs stay on their feet."""
    from scipy.spatial.transform import Rotation

    T = len(clip.positions)
    fade = 1.0 - minimum_jerk(np.arange(T) / (BLEND * clip.fps))
    local = to_local(clip.rotations)
    last = to_local(before.rotations[-1:])[0]
    difference = Rotation.from_matrix(last @ np.swapaxes(local[0], -1, -2)).as_rotvec()
    upper = [b for b in range(len(difference)) if b < INDEX["l_thigh"]]
    for b in upper:
        local[:, b] = Rotation.from_rotvec(fade[:, None] * difference[b]).as_matrix() @ local[:, b]
    moved = fade[:, None] * (before.positions[-1, 0] - clip.positions[0, 0])
    posed = rebuilt(clip, local)
    posed = dataclasses.replace(posed, positions=posed.positions + moved[:, None])
    return _feet_kept(posed, _on_same_spots(clip, before))


def _on_same_spots(clip: Clip, before: Clip) -> Clip:
    """The clip with each foot where the last one left it, until it is lifted and put elsewhere."""
    from scipy.spatial.transform import Rotation

    p, R = clip.positions.copy(), clip.rotations.copy()
    for s in ("l_", "r_"):
        foot, toe = INDEX[s + "foot"], INDEX[s + "toe"]
        away = np.linalg.norm(p[:, foot] - p[0, foot], axis=1)
        stays = 1.0 - minimum_jerk(np.maximum.accumulate(away) / 0.2)
        p[:, foot] += stays[:, None] * (before.positions[-1, foot] - clip.positions[0, foot])
        turned = Rotation.from_matrix(before.rotations[-1, foot] @ clip.rotations[0, foot].T)
        back = Rotation.from_rotvec(stays[:, None] * turned.as_rotvec()).as_matrix()
        R[:, foot], R[:, toe] = back @ R[:, foot], back @ R[:, toe]
    return dataclasses.replace(clip, positions=p, rotations=R)


def _feet_kept(clip: Clip, wanted: Clip) -> Clip:
    """Bend the legs so that the feet are where and as another clip has them."""
    from egocap_sim.motion.kinematics.limbs import solve_limbs

    R = clip.rotations.copy()
    for s in ("l_", "r_"):
        thigh, calf, foot, toe = (INDEX[s + part] for part in ("thigh", "calf", "foot", "toe"))
        forward = wanted.rotations[:, thigh, :, 0]
        R[:, thigh], R[:, calf] = solve_limbs(
            clip.positions[:, thigh], wanted.positions[:, foot], forward,
            figure.THIGH, figure.CALF, knee=True,
        )  # fmt: skip
        R[:, foot], R[:, toe] = wanted.rotations[:, foot], wanted.rotations[:, toe]
    return dataclasses.replace(
        clip, rotations=R, positions=figure.positions(R, clip.positions[:, 0])
    )
