"""Key frames of hands, gaze, trunk and pelvis of a standing body, interpolated to a clip.

Moves add keys at a running clock; curves between keys have minimum jerk. Hand keys are wrist
positions relative to the shoulder at rest, in the chest's frame, for a left arm; the right one is
mirrored.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.motion.generators.stance import HANG, HANG_PRONATION, Style, standing
from egocap_sim.motion.kinematics.balance import balance_pose
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import through, turn
from egocap_sim.motion.kinematics.posing import pose_figure

HAND_SPEED = 0.75  # m/s, mean over a reach at ordinary pace (peak 1.9 times higher)
REACTION = 0.3  # s, least duration of a move
END = 0.15  # s of rest after the last move
BULGE = np.array([0.16, 0.05, 0.0])  # a hand path curves forward and outward


@dataclass(frozen=True)
class PaceParams:
    """How fast a motion is."""

    pace: Annotated[float, (0.5, 2.0)] = 1.0
    """Factor on the duration of moves."""


@dataclass(frozen=True)
class Hand:
    """A hand's key: wrist (left arm), pronation, extension of the wrist, raise of the elbow."""

    wrist: tuple[float, float, float]
    pronation: float = HANG_PRONATION
    bend: float = 0.0
    swivel: float = 0.0

    @property
    def row(self) -> Float[Array, "6"]:
        return np.array([*self.wrist, self.pronation, self.bend, self.swivel])


DOWN = Hand((float(HANG[0]), float(HANG[1]), float(HANG[2])))


@dataclass
class _Track:
    """Keys of one curve: each move is held until the next begins."""

    rows: list[Array]
    times: list[float] = field(default_factory=lambda: [0.0])

    def move(self, start: float, end: float, row: Array) -> None:
        start = max(start, self.times[-1] + 1e-3)
        self.times += [start, max(end, start + 0.1)]
        self.rows += [self.rows[-1], row]

    def at(self, t: Array, bulge: Array | float = 0.0) -> Array:
        return through(t, self.times, np.array(self.rows), bulge)


Move = Callable[["Keyframes"], None]
"""Adds the keys of one move."""


class Keyframes:
    """Collect moves that begin at `clock` [s]; `clip` interpolates and poses them."""

    def __init__(self, style: Style, rng: np.random.Generator, pace: float = 1.0) -> None:
        self.style, self.rng, self.pace, self.clock = style, rng, pace * style.tempo, 0.0
        self.moved = False
        self._hands = [_Track([DOWN.row]) for _ in range(2)]
        self._gaze = _Track([np.zeros(3)])  # yaw, pitch, roll
        self._trunk = _Track([np.zeros(3)])  # yaw, pitch (forward), roll
        self._pelvis = _Track([np.zeros(3)])  # forward, left, up: metres

    def begin(self, key: Hand, hands: Sequence[int] = (0, 1)) -> None:
        """Set the initial keys of hands."""
        for hand in hands:
            self._hands[hand] = _Track([key.row])

    def begin_pelvis(self, forward: float, left: float, up: float) -> None:
        """Set the initial shift of the pelvis from standing, metres."""
        self._pelvis = _Track([np.array([forward, left, up])])

    def begin_gaze(self, yaw: float, pitch: float, roll: float) -> None:
        """Set the initial turn of the head, radians."""
        self._gaze = _Track([np.array([yaw, pitch, roll])])

    def reach_time(self, hand: int, key: Hand) -> float:
        """Seconds of a natural move to a key."""
        last = self._hands[hand].rows[-1]
        distance = np.linalg.norm(last[:3] - key.wrist) + 0.06 * abs(last[3] - key.pronation)
        return (REACTION + float(distance) / HAND_SPEED) * self.pace

    def hand(self, hand: int, key: Hand, seconds: float | None = None, later: float = 0.0) -> float:
        """Move a hand (0 left, 1 right) from the clock on; returns when it arrives."""
        start = self.clock + later
        end = start + (self.reach_time(hand, key) if seconds is None else seconds)
        self._hands[hand].move(start, end, key.row)
        return self._hands[hand].times[-1]

    def both_hands(self, key: Hand, seconds: float | None = None, later: float = 0.0) -> float:
        """Move both hands to mirrored places; returns when the last arrives."""
        return max([self.hand(hand, key, seconds, later) for hand in (0, 1)])

    def gaze(self, yaw: float, pitch: float, seconds: float = 0.5, roll: float = 0.0) -> None:
        """Turn the head, in radians from straight ahead (pitch: positive down)."""
        end = self.clock + seconds * self.pace
        self._gaze.move(self.clock, end, np.array([yaw, pitch, roll]))

    def trunk(self, yaw: float, pitch: float, roll: float, seconds: float) -> None:
        """Turn and bend the chest, in radians from upright."""
        self._trunk.move(self.clock, self.clock + seconds, np.array([yaw, pitch, roll]))

    def pelvis(self, forward: float, left: float, up: float, seconds: float) -> None:
        """Shift the pelvis, metres from standing."""
        self._pelvis.move(self.clock, self.clock + seconds, np.array([forward, left, up]))

    def wait(self, seconds: float) -> None:
        self.clock += seconds

    def perform(self, moves: Sequence[Move], seconds: float) -> bool:
        """Add the first move that ends before `seconds`; return False if none does.

        The very first move is added even if it ends later.
        """
        for move in moves:
            attempt = copy.deepcopy(self)
            move(attempt)
            if attempt.clock <= seconds - END or not self.moved:
                attempt.moved = True
                self.__dict__.update(attempt.__dict__)
                return True
        return False

    def repeat(self, move: Move, seconds: float, rest_s: Callable[[], float] = lambda: 0.0) -> None:
        """Repeat a move, each time followed by a rest, while it ends before `seconds`."""
        while self.perform([move], seconds):
            self.wait(rest_s())

    def clip(self, name: str, t: Float[Array, "T"], fps: float, balance: bool = True) -> Clip:
        """Pose the figure at the times t [s]."""
        c = standing(t, self.style, self.rng)
        rest = DOWN.row
        for i, track in enumerate(self._hands):
            sign = 1.0 - 2.0 * i
            mirror = np.array([1.0, sign, 1.0])
            row = track.at(t, np.array([*BULGE, 0.0, 0.0, 0.0]) * 0.8)
            c.wrist[:, i] += (row[:, :3] - rest[:3]) * mirror
            c.pronation[:, i] += row[:, 3] - rest[3]
            c.wrist_bend[:, i] += row[:, 4]
            c.swivel[:, i] += row[:, 5]
        yaw, pitch, roll = self._trunk.at(t).T
        share = turn(yaw=0.3 * yaw, pitch=0.45 * pitch, roll=0.3 * roll)
        c.pelvis_R = share @ c.pelvis_R
        c.chest_R = turn(yaw=yaw, pitch=pitch, roll=roll) @ c.chest_R
        look = self._gaze.at(t)
        c.head_R = turn(yaw=look[:, 0], pitch=look[:, 1], roll=look[:, 2]) @ c.head_R
        c.pelvis = c.pelvis + self._pelvis.at(t)
        if not balance:
            return pose_figure(name, fps, c)
        return balance_pose(c, lambda controls: pose_figure(name, fps, controls))
