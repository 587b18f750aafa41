"""Whole-body poses and the interpolation between them.

A foot is placed by its toe joint, so that the heel rises about a fixed ball of the foot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.keyframes import BULGE, DOWN, Hand
from egocap_sim.motion.generators.stance import HIP_HEIGHT, TOE_OUT, Style, standing
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.balance import OVER, balance_pose, centre_of_mass
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import through, turn
from egocap_sim.motion.kinematics.posing import Controls, pose_figure

TOE_HEIGHT = float(figure.REST[-1, 2])
"""Height of the toe joint of a standing foot, metres."""
_ANKLE = -figure.offset("l_toe", "l_foot")  # from the toe joint, in the foot's frame
_STEP_LIFT = 0.28  # lift of a stepping foot, fraction of the step length
_OFF_SHOULDER = 0.2  # metres: a hand path closer to the shoulder would fold the arm
_MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Foot:
    """Position and orientation of a foot, world."""

    toe: tuple[float, float, float]  # the toe joint, metres
    yaw: float = 0.0
    pitch: float = 0.0  # radians; positive: heel up
    roll: float = 0.0
    bend: float = 0.0  # radians the toes bend up from the foot
    splay: float = 0.0  # radians the knee points outward from where the pelvis faces

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        return turn(yaw=self.yaw, pitch=self.pitch, roll=self.roll)

    @property
    def ankle(self) -> Float[Array, "3"]:
        """World position of the ankle, metres."""
        return self.toe + self.rotation @ _ANKLE

    @property
    def row(self) -> Float[Array, "8"]:
        return np.array([*self.toe, self.yaw, self.pitch, self.roll, self.bend, self.splay])


def foot_on_ground(x: float, y: float, yaw: float, heel: float = 0.0, splay: float = 0.0) -> Foot:
    """A foot with the toes flat on the ground at (x, y) and the heel raised by an angle."""
    return Foot((x, y, TOE_HEIGHT), yaw, heel, 0.0, heel, splay)


def place_ankle(foot: Foot, ankle: Float[Array, "3"]) -> Foot:
    """Move a foot so that its ankle is at a world point."""
    x, y, z = ankle - foot.rotation @ _ANKLE
    return replace(foot, toe=(float(x), float(y), float(z)))


def standing_feet(
    half_width: float = 0.095, ahead: float = 0.0, turned: float = TOE_OUT
) -> tuple[Foot, Foot]:
    """Both feet flat on either side of the origin; `ahead` puts the left one before the right."""
    left, right = (
        place_ankle(
            Foot((0, 0, 0), yaw=sign * turned, splay=turned),
            np.array([sign * ahead / 2, sign * half_width, figure.REST[-2, 2]]),
        )
        for sign in (1.0, -1.0)
    )
    return left, right


@dataclass(frozen=True)
class WholePose:
    """Parameters of a pose. Angles are yaw, pitch (forward), roll, in radians."""

    pelvis: tuple[float, float, float] = (0.012, 0.0, float(HIP_HEIGHT))  # metres, world
    hips: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the pelvis in the world
    chest: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in the world
    look: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the head on the chest
    feet: tuple[Foot, Foot] = standing_feet()
    hands: tuple[Hand, Hand] = (DOWN, DOWN)
    support: tuple[float, float] = (0.04, 0.0)  # metres, world: below the centre of mass

    @property
    def on_one_foot(self) -> bool:
        """Whether a foot is off the ground."""
        return any(foot.toe[2] > TOE_HEIGHT + 0.02 for foot in self.feet)

    @property
    def row(self) -> Float[Array, "14"]:
        return np.array([*self.pelvis, *self.hips, *self.chest, *self.look, *self.support])


def support_point(feet: tuple[Foot, Foot], share: float = 0.5) -> tuple[float, float]:
    """Ground point below the centre of mass, with a share of the weight on the right foot."""
    ankles = np.array([f.ankle[:2] for f in feet])
    ahead = np.array([f.rotation[:2, 0] for f in feet])
    x, y = np.array([1.0 - share, share]) @ (ankles + OVER * ahead)
    return float(x), float(y)


def pose_clip(pose: WholePose, hands: Float[Array, "T 2 6"] | None = None) -> Clip:
    """Pose the figure; with `hands` one frame per row, which replaces the pose's own hands."""
    rows = np.array([[h.row for h in pose.hands]]) if hands is None else hands
    T = len(rows)
    feet = np.array([[f.row for f in pose.feet]])
    body, feet = np.repeat(pose.row[None], T, 0), np.repeat(feet, T, 0)
    return pose_figure("pose", 30.0, _controls(body, feet, rows))


def balance_on_feet(pose: WholePose, lifted: int | None = None) -> WholePose:
    """Shift the pelvis until the centre of mass is above `support`; a `lifted` foot moves along."""
    for _ in range(3):
        off = np.array(pose.support) - centre_of_mass(pose_clip(pose))[0, :2]
        move = np.array([*off, 0.0])
        pose = replace(pose, pelvis=tuple(np.asarray(pose.pelvis) + move))
        if lifted is not None:
            feet = list(pose.feet)
            feet[lifted] = replace(feet[lifted], toe=tuple(feet[lifted].toe + move))
            pose = replace(pose, feet=tuple(feet))
    return pose


def support_at_mass_centre(pose: WholePose) -> WholePose:
    """Set `support` below the centre of mass, for poses not carried by the feet alone."""
    x, y = centre_of_mass(pose_clip(pose))[0, :2]
    return replace(pose, support=(float(x), float(y)))


def interpolate_poses(
    poses: Sequence[WholePose],
    times: Float[Array, "K 2"],
    t: Float[Array, "T"],
    style: Style,
    rng: np.random.Generator,
    fps: float,
) -> Clip:
    """Move from pose to pose; `times` [s] are the start and the end of the move to each.

    The first pose is held from the start. Feet step one after the other.
    """
    rows, at = [poses[0]], [0.0]
    for pose, (begin, end) in zip(poses[1:], times[1:], strict=True):
        rows += [rows[-1], pose]
        at += [float(begin), float(end)]
    body = through(t, at, np.array([p.row for p in rows]))
    feet = np.stack([_foot(t, at, rows, i) for i in range(2)], 1)
    hands = np.stack([_hand(t, at, rows, i) for i in range(2)], 1)
    controls = _controls(body, feet, hands)
    idle = standing(t, style, rng)
    controls = replace(
        controls,
        pelvis_R=controls.pelvis_R @ idle.pelvis_R,
        chest_R=controls.chest_R @ idle.chest_R,
        head_R=controls.head_R @ idle.head_R,
        wrist=controls.wrist + idle.wrist - idle.wrist.mean(0),
    )
    return balance_pose(controls, lambda c: pose_figure("poses", fps, c), support=body[:, 12:14])


def _foot(t: Array, at: list[float], rows: list[WholePose], side: int) -> Float[Array, "T 8"]:
    """A foot's row over time; a stepping foot is lifted, and the left foot steps first."""
    values = np.array([p.feet[side].row for p in rows])
    moves = [[a.feet[i] != b.feet[i] for i in range(2)] for a, b in pairwise(rows)]
    lift = [0.0 if a.on_one_foot or b.on_one_foot else _STEP_LIFT for a, b in pairwise(rows)]
    mine = [at[0]]
    for both, begin, end in zip(moves[1::2], at[1::2], at[2::2], strict=True):
        middle = begin + (0.52 if side else 0.48) * (end - begin)
        mine += ([middle, end] if side else [begin, middle]) if all(both) else [begin, end]
    k = np.clip(np.searchsorted(mine, t, side="right") - 1, 0, len(mine) - 2)
    toe = through(t, mine, values[:, :3], np.array(lift)[k, None] * [0.0, 0.0, 1.0])
    return np.concatenate([toe, through(t, mine, values[:, 3:])], 1)


def _hand(t: Array, at: list[float], rows: list[WholePose], side: int) -> Float[Array, "T 6"]:
    """A hand's row over time, on a path curved around the shoulder."""
    values = np.array([p.hands[side].row for p in rows])
    curve = np.array([*BULGE, 0.0, 0.0, 0.0]) * 0.8
    more = [_detour(a, b) for a, b in zip(values[:-1, :3], values[1:, :3], strict=True)]
    k = np.clip(np.searchsorted(at, t, side="right") - 1, 0, len(at) - 2)
    return through(t, at, values, np.array(more)[k, None] * curve)


def _detour(a: Float[Array, "3"], b: Float[Array, "3"]) -> float:
    """Factor on the curvature of a hand path that keeps it off the shoulder."""
    s = np.linspace(0.0, 1.0, 9)[:, None]
    out = 4.0 * s * (1.0 - s) * np.linalg.norm(b - a) * 0.8 * BULGE
    for factor in (1.0, 2.0, 3.0, 4.0):
        if np.linalg.norm(a + s * (b - a) + factor * out, axis=1).min() > _OFF_SHOULDER:
            break
    return factor


def _controls(
    body: Float[Array, "T 14"], feet: Float[Array, "T 2 8"], hands: Float[Array, "T 2 6"]
) -> Controls:
    """Controls from rows of the body, the feet and the hands."""
    chest = turn(*body[:, 6:9].T)
    foot_R = turn(feet[..., 3], feet[..., 4], feet[..., 5])
    signs = np.stack([np.ones(3), _MIRROR])
    return Controls(
        pelvis=body[:, :3],
        pelvis_R=turn(*body[:, 3:6].T),
        chest_R=chest,
        head_R=chest @ turn(*body[:, 9:12].T),
        ankle=feet[..., :3] + foot_R @ _ANKLE,
        foot_R=foot_R,
        toe=feet[..., 6],
        wrist=hands[..., :3] * signs,
        pronation=hands[..., 3],
        wrist_bend=hands[..., 4],
        swivel=hands[..., 5],
        splay=feet[..., 7],
    )
