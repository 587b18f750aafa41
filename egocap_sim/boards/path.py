"""The path of a board in a hand before a rig: rests all over the views, and moves between them.

The hand rests where each camera, or two at once, see much of the board, from the optical axis to
the rim; it moves between rests with the minimum-jerk profile and trembles.

Source: Flash and Hogan 1985, minimum-jerk movements; physiological tremor of some millimetres
below 4 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from egocap.boards.board import Board
from egocap.cameras.rig import Rig
from egocap.geometry import inverse, rigid, transform, unit

REST_S = 1.0  # from one rest to the next
_HOLD = 0.25  # share of it at rest
_TREMOR_M, _TREMOR_RAD = 0.0012, 0.006  # standard deviations
_TREMOR_HZ = (0.6, 3.5)
_WAVES = 6
_TRIES = 4000
_TILT = np.deg2rad(50.0)  # of the board against the line of sight


@dataclass(frozen=True, eq=False)
class BoardPath:
    """The pose of a board in the rig frame over time."""

    rests: Float[Array, "N 4 4"]
    tremor: CubicSpline  # rotation vector and translation (6)

    @property
    def times(self) -> Float[Array, "N"]:
        """Times of the rests, seconds."""
        return REST_S * np.arange(len(self.rests))

    def T_rig_board(self, times: Float[Array, "*n"]) -> Float[Array, "*n 4 4"]:
        """Poses at times in seconds; before the first and after the last rest, of these."""
        s = np.clip(np.asarray(times, float) / REST_S, 0.0, len(self.rests) - 1)
        k = np.clip(np.floor(s).astype(int), 0, max(len(self.rests) - 2, 0))
        share = np.clip((s - k - _HOLD / 2) / (1 - _HOLD), 0.0, 1.0)
        share = share**3 * (10 - 15 * share + 6 * share**2)
        first, last = self.rests[k], self.rests[np.minimum(k + 1, len(self.rests) - 1)]
        start = Rotation.from_matrix(first[..., :3, :3].reshape(-1, 3, 3))
        turn = (start.inv() * Rotation.from_matrix(last[..., :3, :3].reshape(-1, 3, 3))).as_rotvec()
        trembling = self.tremor(np.asarray(times, float))
        moved = Rotation.from_rotvec(turn * share.reshape(-1, 1))
        turned = start * moved * Rotation.from_rotvec(trembling[..., :3].reshape(-1, 3))
        position = first[..., :3, 3] + share[..., None] * (last - first)[..., :3, 3]
        R = turned.as_matrix().reshape(*share.shape, 3, 3)
        return rigid(R, position + trembling[..., 3:])


def draw_path(board: Board, rig: Rig, count: int, rng: np.random.Generator) -> BoardPath:
    """Draw a path with `count` rests; every other one lies before two cameras, if it can."""
    rests = [_draw_rest(board, rig, i, rng) for i in range(count)]
    times = np.arange(-0.5, REST_S * count + 0.5, 0.02)
    return BoardPath(_in_order(np.array(rests)), CubicSpline(times, _tremor(times, rng)))


def _draw_rest(board: Board, rig: Rig, index: int, rng: np.random.Generator) -> Array:
    """A pose in which a camera sees at least half of the corners, and a second as many."""
    views = len(rig.views)
    both = views > 1 and index % 2 == 1
    view, radius = (index // 2) % views, rng.uniform(0.0, 1.0)
    best, most = np.eye(4), -1.0
    for _ in range(_TRIES):
        T = _draw_pose(board, rig, view, radius, both, rng)
        seen = np.sort([_visible(board, rig, v, T) for v in range(views)])[::-1]
        enough = seen[: 1 + both].min()
        if enough > most and _visible(board, rig, view, T) > 0:
            best, most = T, enough
        if most >= rng.uniform(0.5, 1.0):
            break
        radius = rng.uniform(0.0, 1.0)
    return best


def _draw_pose(
    board: Board, rig: Rig, view: int, radius: float, far: bool, rng: np.random.Generator
) -> Float[Array, "4 4"]:
    """T_rig_board at a share of the lens's field, facing the camera but for a tilt."""
    mount = rig.mounts[view]
    theta = radius * min(mount.camera.max_angle, np.deg2rad(92.0))
    azimuth = rng.uniform(0.0, 2 * np.pi)
    flat = np.sin(theta) * np.array([np.cos(azimuth), np.sin(azimuth)])
    sight = np.array([*flat, np.cos(theta)])
    diagonal = float(np.hypot(*board.size))
    distance = diagonal * (rng.uniform(1.1, 2.2) if far else rng.uniform(0.55, 1.4))
    across = unit(np.cross(sight, rng.normal(size=3)))
    R = np.column_stack([across, np.cross(sight, across), sight])
    tilt = Rotation.from_rotvec(unit(rng.normal(size=3)) * _TILT * np.sqrt(rng.random()))
    R = R @ tilt.as_matrix()
    middle = np.array([*board.size, 0.0]) / 2
    return mount.T_head_camera @ rigid(R, distance * sight - R @ middle)


def _visible(board: Board, rig: Rig, view: int, T_rig_board: Array) -> float:
    """Share of the corners that a camera sees on the board's front."""
    T = inverse(rig.mounts[view].T_head_camera) @ T_rig_board
    points = transform(T, board.points)
    _, valid = rig.cameras[view].project(points)
    return float((valid & (unit(points) @ T[:3, 2] > 0.2)).mean())


def _in_order(rests: Float[Array, "N 4 4"]) -> Float[Array, "N 4 4"]:
    """The rests from each to the nearest one left."""
    order, left = [0], set(range(1, len(rests)))
    while left:
        here = rests[order[-1], :3, 3]
        order.append(min(left, key=lambda i: float(np.linalg.norm(rests[i, :3, 3] - here))))
        left.remove(order[-1])
    return rests[order]


def _tremor(times: Float[Array, "T"], rng: np.random.Generator) -> Float[Array, "T 6"]:
    low, high = np.log(_TREMOR_HZ)
    frequency = np.exp(rng.uniform(low, high, (_WAVES, 6)))
    phase = rng.uniform(0.0, 2 * np.pi, (_WAVES, 6))
    waves = np.sin(2 * np.pi * frequency * times[:, None, None] + phase)
    scale = np.array([_TREMOR_RAD] * 3 + [_TREMOR_M] * 3)
    return scale * np.sqrt(2.0 / _WAVES) * waves.sum(1)
