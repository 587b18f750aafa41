"""Sequences of random static poses, for training on poses that ordinary motions rarely contain.

Hands reach anywhere, also to the head, the body, the legs and the floor. Head, trunk and hips turn
and bend within their limits; legs squat, kneel, bend or balance. Poses that penetrate the body or
exceed a joint limit are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import HAND_SPEED, REACTION, PaceParams
from egocap_sim.motion.generators.pose_sampling import LEGS, is_feasible
from egocap_sim.motion.generators.stance import Style, draw_style
from egocap_sim.motion.generators.touches import sample_hands
from egocap_sim.motion.generators.whole_pose import WholePose, interpolate_poses
from egocap_sim.motion.kinematics.clip import Clip

_TRIES = 12
_HOLD_S = (0.0, 0.5)
_FOOT_SPEED = 1.3  # m/s, mean
_HIP_SPEED, _TURN_SPEED, _STEP_S = 0.5, 1.0, 0.5  # m/s, rad/s; seconds per step of a foot
_TURN_MOST, _SLOWED = 12.0, 4  # rad/s of any body; how often a clip is slowed down to it
_TOUCHES = 0.45, 0.75  # share of hands that touch something: standing, and low
_LOW = {"bend": 0.85, "crouch": 0.75, "kneel": 0.5, "stride": 0.4, "balance": 0.2}  # else none


@dataclass(frozen=True)
class PosesParams(PaceParams):
    """Random reachable poses, one after another."""

    size: Annotated[float, (0.4, 1.15)] = 1.0
    """Factor on how far head, trunk and hips go."""
    kinds: Annotated[tuple[str, ...], LEGS] = ()
    """Names of kinds of poses; empty: all of them, the ordinary ones oftener."""


def poses(t: Float[Array, "T"], rng: np.random.Generator, params: PosesParams, fps: float) -> Clip:
    """Move through random poses for the times t [s]."""
    style = draw_style(rng)
    keys, times = [WholePose()], [(0.0, float(rng.uniform(0.05, 0.3)))]
    while times[-1][1] < t[-1]:
        pose = draw_pose(rng, params.size, params.kinds)
        way = [pose]
        if keys[-1].on_one_foot or pose.on_one_foot:
            way.insert(0, WholePose(hands=pose.hands))  # no hop from one foot to the other
        for pose in way:
            begin = times[-1][1]
            seconds = _move_duration(keys[-1], pose) * float(rng.uniform(0.85, 1.4))
            keys.append(pose)
            times.append((begin, begin + seconds * params.pace * style.tempo))
        keys.append(pose)
        held = times[-1][1] + float(rng.uniform(*_HOLD_S)) * params.pace
        times.append((times[-1][1], held))
    return _limit_speed(keys, np.array(times), t, style, int(rng.integers(2**53)), fps)


def _limit_speed(
    keys: list[WholePose], times: Float[Array, "K 2"], t: Float[Array, "T"], style: Style,
    seed: int, fps: float,
) -> Clip:  # fmt: skip
    """Interpolate poses; moves in which a body turns too fast take longer."""
    clip = interpolate_poses(keys, times, t, style, np.random.default_rng(seed), fps)
    for _ in range(_SLOWED):
        longer = _peak_speed(clip, t, times) / _TURN_MOST
        if longer.max() <= 1.0:
            break
        longer = np.clip(1.1 * longer, 1.0, 3.0)
        waits = np.diff(times.ravel(), prepend=0.0).reshape(-1, 2)
        times = np.cumsum(waits * np.stack([np.ones(len(times)), longer], 1)).reshape(-1, 2)
        clip = interpolate_poses(keys, times, t, style, np.random.default_rng(seed), fps)
    return clip


def _peak_speed(clip: Clip, t: Float[Array, "T"], times: Float[Array, "K 2"]) -> Float[Array, "K"]:
    """Largest angular speed of any body in the move to each pose, rad/s."""
    turned = np.einsum("tbij,tbij->tb", clip.rotations[1:], clip.rotations[:-1])  # 1 + 2 cos
    speed = clip.fps * np.arccos(np.clip(0.5 * turned - 0.5, -1.0, 1.0)).max(1)
    return np.array([
        speed[(t[1:] > begin) & (t[:-1] < end)].max(initial=0.0) for begin, end in times
    ])  # fmt: skip


def draw_pose(
    rng: np.random.Generator, size: float = 1.0, kinds: tuple[str, ...] = ()
) -> WholePose:
    """A feasible random pose of a kind in `LEGS`."""
    names = kinds or tuple(LEGS)
    weights = np.array([LEGS[name][1] for name in names])
    kind = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    for _ in range(_TRIES):
        pose = LEGS[kind][0](rng, size)
        if is_feasible(pose):
            low = _LOW.get(kind, 0.0)
            done = sample_hands(rng, pose, _TOUCHES[low > 0.3], low)
            if done is not None:
                return done
    return WholePose()


def _move_duration(a: WholePose, b: WholePose) -> float:
    """Seconds that a natural move from one pose to another takes."""
    moved = np.abs(b.row - a.row)
    hips = float(np.linalg.norm(moved[:3])) / _HIP_SPEED
    turned = float(moved[3:12].max()) / _TURN_SPEED
    hands = max(
        float(np.linalg.norm(np.subtract(x.wrist, y.wrist))) / HAND_SPEED
        for x, y in zip(a.hands, b.hands, strict=True)
    )
    stepped = sum(
        float(np.linalg.norm(np.subtract(x.toe, y.toe))) > 0.02 or abs(x.yaw - y.yaw) > 0.1
        for x, y in zip(a.feet, b.feet, strict=True)
    )
    kicked = max(
        float(np.linalg.norm(np.subtract(x.toe, y.toe)))
        for x, y in zip(a.feet, b.feet, strict=True)
    ) / _FOOT_SPEED  # fmt: skip
    return max(REACTION + max(hips, turned, hands), _STEP_S * stepped + 0.2, kicked, 0.7)
