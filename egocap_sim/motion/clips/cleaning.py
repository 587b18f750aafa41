"""Repair recorded motion: spikes, angles beyond joint limits, the height of the floor.

Rotations are repaired relative to the parent body, so that a glitch of one body does not spread to
others. `clip_check` lists what was found and changed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.geometry import matrix_to_quaternion, quaternion_to_matrix
from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import continuous
from egocap_sim.motion.kinematics.figure import leg_length

MAX_SPEED = 40.0  # rad/s relative to the parent; throwing arms reach about 30
MEDIAN_WINDOW = 0.15  # s; a spike is shorter than half of it
MAX_DEVIATION = 0.5  # rad from the running median
CUT_SPEED, CUT_BODIES = 22.0, 4  # rad/s in a single frame of that many bodies, or ...
CUT_ROOT_SPEED = 12.0  # m/s of the pelvis: a cut (often after a leading bind pose)
MAX_GLITCH = 1.5  # s; a jump away and back within this is a glitch
GLIDE = 0.08  # s before and after a jump without return, over which it is spread
MAX_ANGLE = {
    "toe": 1.2, "foot": 1.45, "hand": 1.75, "head": 1.6, "neck": 1.2,
    "spine": 1.3, "chest": 1.3, "clavicle": 1.0,
}  # fmt: skip
"""Largest plausible rotation of a body relative to its parent, radians."""
ANKLE_HEIGHT, TOE_HEIGHT = 0.095, 0.03  # of the leg's length, above the sole
FLOOR_QUANTILE = 0.06  # of the frames may have their lower sole under the floor


def longest_take(clip: Clip) -> tuple[Clip, int]:
    """The longest stretch without a cut, and the number of frames left out."""
    if len(clip.positions) < 2:
        return clip, 0
    q = matrix_to_quaternion(to_local(clip.rotations))
    speed = _angle(q[1:], q[:-1]) * clip.fps
    around = np.pad(speed, ((1, 1), (0, 0)))
    sudden = speed > np.maximum(CUT_SPEED, 3.0 * np.maximum(around[:-2], around[2:]))
    root = np.linalg.norm(np.diff(clip.positions[:, 0], axis=0), axis=1) * clip.fps
    cuts = np.flatnonzero((sudden.sum(1) >= CUT_BODIES) | (root > CUT_ROOT_SPEED)) + 1
    edges = np.array([0, *cuts, len(q)])
    longest = int(np.diff(edges).argmax())
    a, b = int(edges[longest]), int(edges[longest + 1])
    kept = dataclasses.replace(clip, positions=clip.positions[a:b], rotations=clip.rotations[a:b])
    return kept, len(q) - (b - a)


def despike(clip: Clip) -> tuple[Clip, int]:
    """Replace spikes and glitches by interpolation; returns the clip and their number.

    A frame is a spike where a body, relative to its parent, is far from its running median, or lies
    between two jumps faster than `MAX_SPEED` that cancel out. A jump without return is spread
    over `GLIDE`.
    """
    local = to_local(clip.rotations)
    q = continuous(matrix_to_quaternion(local))
    bad = _far_from_median(q, clip.fps)
    for b in range(q.shape[1]):
        bad[:, b] |= _between_jumps(_interpolate(q[:, b], bad[:, b]), clip.fps)
        bad[:, b] |= _at_jumps(_interpolate(q[:, b], bad[:, b]), clip.fps)
    return _interpolate_frames(clip, local, q, bad)


def repair_beyond_limits(clip: Clip) -> tuple[Clip, int]:
    """Replace rotations beyond the joint limits (`MAX_ANGLE`); needs canonical rotations.

    A body beyond its limit in most frames is fixed to its parent.
    """
    assert clip.canonical, clip.name
    local = to_local(clip.rotations)
    q = continuous(matrix_to_quaternion(local))
    bad = np.zeros(q.shape[:2], bool)
    for b, body in enumerate(BODIES):
        limit = MAX_ANGLE.get(body.removeprefix("l_").removeprefix("r_"), np.inf)
        bad[:, b] = 2.0 * np.arccos(np.clip(np.abs(q[:, b, 0]), 0.0, 1.0)) > limit
        if bad[:, b].mean() > 0.5:
            q[:, b], bad[:, b] = (1.0, 0.0, 0.0, 0.0), True
    return _interpolate_frames(clip, local, q, bad)


def interpolate_bodies(clip: Clip, bodies: Sequence[str], bad: Bool[Array, "T"]) -> Clip:
    """The clip with the rotations of bodies to their parents interpolated over bad frames.

    Where most frames are bad, the bodies are fixed to their parents.
    """
    local = to_local(clip.rotations)
    q = continuous(matrix_to_quaternion(local))
    mask = np.zeros(q.shape[:2], bool)
    for b in (INDEX[body] for body in bodies):
        mask[:, b] = bad
        if bad.mean() > 0.5:
            q[:, b], mask[:, b] = (1.0, 0.0, 0.0, 0.0), True
    return _interpolate_frames(clip, local, q, mask)[0]


def sole_heights(clip: Clip) -> Float[Array, "T"]:
    """Height of the lower sole in each frame, metres."""
    p = clip.positions
    leg = leg_length(p)
    soles = [
        p[:, INDEX[s + part], 2] - leg * above
        for s in ("l_", "r_")
        for part, above in (("foot", ANKLE_HEIGHT), ("toe", TOE_HEIGHT))
    ]
    return np.min(soles, axis=0)


def floor_height(clip: Clip) -> float:
    """Height of the floor under a clip, from the lower sole of each frame, in metres."""
    return float(np.quantile(sole_heights(clip), FLOOR_QUANTILE))


def put_on_floor(clip: Clip) -> tuple[Clip, float]:
    """The clip with its floor at z = 0, and the height added."""
    shift = -floor_height(clip)
    return dataclasses.replace(clip, positions=clip.positions + [0.0, 0.0, shift]), shift


def to_local(world: Float[Array, "T B 3 3"]) -> Float[Array, "T B 3 3"]:
    """Rotations of the bodies relative to their parents."""
    local = world.copy()
    for b, p in enumerate(PARENTS):
        if p >= 0:
            local[:, b] = np.swapaxes(world[:, p], 1, 2) @ world[:, b]
    return local


def with_local_rotations(clip: Clip, local: Float[Array, "T B 3 3"]) -> Clip:
    """The clip with other rotations relative to the parents; bone vectors are preserved."""
    R, p = local.copy(), clip.positions.copy()
    for b, parent in enumerate(PARENTS):
        if parent >= 0:
            R[:, b] = R[:, parent] @ local[:, b]
            offset = clip.positions[:, b] - clip.positions[:, parent]
            turn = R[:, parent] @ np.swapaxes(clip.rotations[:, parent], 1, 2)
            p[:, b] = p[:, parent] + np.einsum("tij,tj->ti", turn, offset)
    return dataclasses.replace(clip, rotations=R, positions=p)


def _interpolate_frames(
    clip: Clip, local: Float[Array, "T B 3 3"], q: Float[Array, "T B 4"], bad: Bool[Array, "T B"]
) -> tuple[Clip, int]:
    """The clip with bad body frames interpolated; others are unchanged to the bit."""
    if not bad.any():
        return clip, 0
    local = local.copy()
    for b in np.flatnonzero(bad.any(0)):
        fixed = _interpolate(q[:, b], bad[:, b])
        local[bad[:, b], b] = quaternion_to_matrix(fixed[bad[:, b]])
    return with_local_rotations(clip, local), int(bad.sum())


def _angle(a: Float[Array, "*n 4"], b: Float[Array, "*n 4"]) -> Float[Array, "*n"]:
    return 2.0 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0.0, 1.0))


def _far_from_median(q: Float[Array, "T B 4"], fps: float) -> Bool[Array, "T B"]:
    from scipy.ndimage import median_filter

    window = 2 * max(1, round(0.5 * MEDIAN_WINDOW * fps)) + 1
    median = median_filter(q, size=(window, 1, 1), mode="nearest")
    median /= np.maximum(np.linalg.norm(median, axis=-1, keepdims=True), 1e-9)
    return _angle(q, median) > MAX_DEVIATION


def _between_jumps(q: Float[Array, "T 4"], fps: float) -> Bool[Array, "T"]:
    """Frames between a jump away and the jump back."""
    bad = np.zeros(len(q), bool)
    step = _angle(q[1:], q[:-1])
    jumps = np.flatnonzero(step > min(MAX_SPEED / fps, 2.5)) + 1  # first frame after each
    i = 0
    while i < len(jumps):
        first, before = jumps[i], q[jumps[i] - 1]
        back = [
            e for e in jumps[i + 1 :]
            if e - first <= MAX_GLITCH * fps and _angle(q[e], before) < 0.5 * step[first - 1]
        ]  # fmt: skip
        if back:
            bad[first : back[-1]] = True
            i = int(np.searchsorted(jumps, back[-1], side="right"))
        else:
            i += 1
    return bad


def _at_jumps(q: Float[Array, "T 4"], fps: float) -> Bool[Array, "T"]:
    """Frames close to a jump."""
    from scipy.ndimage import binary_dilation

    bad = np.zeros(len(q), bool)
    bad[1:] = _angle(q[1:], q[:-1]) * fps > MAX_SPEED
    if not bad.any():
        return bad
    reach = max(1, round(GLIDE * fps))
    near = np.asarray(binary_dilation(bad, iterations=reach), bool)
    return near & ~np.isin(np.arange(len(q)), (0, len(q) - 1))


def _interpolate(q: Float[Array, "T 4"], bad: Bool[Array, "T"]) -> Float[Array, "T 4"]:
    """Spherical interpolation over bad frames; held at the ends; unchanged if all are bad."""
    from scipy.spatial.transform import Rotation, Slerp

    good = np.flatnonzero(~bad)
    if len(good) in (0, len(q)):
        return q
    if len(good) == 1:
        return np.broadcast_to(q[good], q.shape).copy()
    times = np.clip(np.arange(len(q)), good[0], good[-1])
    slerp = Slerp(good, Rotation.from_quat(q[good][:, [1, 2, 3, 0]]))
    fixed = slerp(times).as_quat()[:, [3, 0, 1, 2]]
    return np.where(bad[:, None], fixed, q)
