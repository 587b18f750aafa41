"""Climb a staircase, turn on its landing and descend, repeatedly.

The lanes up and down lie side by side along x. Lengths are for the standard figure; a person's
staircase is `leg_scale` times as large, and `fit_climber` places the feet on its treads.

Source: R. Riener et al., Stair ascent and descent at different inclinations, Gait and Posture 15
(2002), for the trunk's lean and the feet: flat strike going up, ball first going down.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.ground_boxes import GroundBox, ground_height
from egocap_sim.human.body.person import Person
from egocap_sim.human.body.soles import sole_points
from egocap_sim.motion.generators.cycling import leg_scale
from egocap_sim.motion.generators.footsteps import (
    FULL_STEP,
    LIFT_PITCH,
    MIDSTANCE,
    STANCE,
    STRIKE_PITCH,
    Plant,
    roll_feet,
)
from egocap_sim.motion.generators.keyframes import PaceParams
from egocap_sim.motion.generators.stance import (
    HIP_HEIGHT,
    TOE_OUT,
    Style,
    draw_style,
)
from egocap_sim.motion.generators.walk import WalkParams, gait_controls, swinging_arms
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import slow_noise, turn
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.kinematics.limbs import bend_limb
from egocap_sim.motion.kinematics.posing import Controls, pose_figure
from egocap_sim.motion.retarget.foot_planting import foot_correction, standing
from egocap_sim.motion.retarget.retarget import Reference

STEP_S = 0.62  # seconds from one foot to the other
FIRST_RISER = -0.85  # x
LANE = 0.7  # metres between the centre lines of the lanes up and down
WIDE = (-0.5, 1.2)  # y: from edge to edge
LANDING = 1.45  # metres deep
FEET_APART = 0.16
HEEL_ON = 0.03  # metres of the ankle behind the edge of a tread, going up
TOES_BACK = 0.214  # the same going down, with the toes at the edge
STARTS = 0.4  # seconds of standing
_NEAR_EDGE = 0.02  # metres of clearance to edges


@dataclass(frozen=True)
class StairsParams(PaceParams):
    """A staircase and the pace on it."""

    treads: Annotated[float, (2.0, 8.0)] = 5.0
    """Steps up to the landing."""
    rise: Annotated[float, (0.1, 0.19)] = 0.165
    """Height of a step in metres."""
    run: Annotated[float, (0.28, 0.36)] = 0.30
    """Depth of a tread in metres."""


def stair_boxes(params: StairsParams, scale: float = 1.0) -> tuple[GroundBox, ...]:
    """Treads from the lowest to the landing, `scale` times those of the figure."""
    count = round(params.treads)
    found = []
    for i in range(1, count + 1):
        near = FIRST_RISER + (i - 1) * params.run
        far = near + (LANDING if i == count else params.run)
        low, high = scale * np.array([near, WIDE[0]]), scale * np.array([far, WIDE[1]])
        found.append(
            GroundBox((float(low[0]), float(low[1])), (float(high[0]), float(high[1])),
                 scale * i * params.rise)
        )  # fmt: skip
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Footfalls:
    """For each step the point between the feet, the heading, the ground height and the slope."""

    xy: Float[Array, "K 2"]
    heading: Float[Array, "K"]
    height: Float[Array, "K"]  # of the ground, metres
    slope: Float[Array, "K"]  # +1 up a step, -1 down one, 0 level


def footfalls(params: StairsParams, count: int) -> Footfalls:
    """The first `count` steps; row 0 is the initial stand."""
    n, run = round(params.treads), params.run
    edge = FIRST_RISER + np.arange(n + 1) * run - run  # of the floor and each tread
    radius, foot = LANE / 2, edge[0] + HEEL_ON
    rows = [(foot - 0.6, 0.0, 0.0, 0, 0), (foot - 0.3, 0.0, 0.0, 0, 0), (foot, 0.0, 0.0, 0, 0)]
    turns = 0
    while len(rows) < count:
        rows += [(edge[i] + HEEL_ON, 0.0, 2 * turns, i, 1) for i in range(1, n + 1)]
        on = edge[n] + TOES_BACK + 0.30
        rows += _on_level(edge[n] + HEEL_ON, on, 0.0, 2 * turns, n)
        rows += _around(on, 1.0, radius, 2 * turns, n)
        rows += [(edge[n] + TOES_BACK, LANE, 2 * turns + 1, n, 0)]
        rows += [(edge[i] + TOES_BACK, LANE, 2 * turns + 1, i, -1) for i in range(n - 1, -1, -1)]
        off = edge[0] + TOES_BACK - 0.6
        rows += _on_level(edge[0] + TOES_BACK, off, LANE, 2 * turns + 1, 0)
        rows += _around(off, -1.0, radius, 2 * turns + 1, 0)
        turns += 1
        rows += _on_level(off, foot, 0.0, 2 * turns, 0)
    x, y, halves, level, slope = np.array(rows[:count], float).T
    return Footfalls(np.stack([x, y], -1), np.pi * halves, params.rise * level, slope)


def stairs(
    t: Float[Array, "T"], rng: np.random.Generator, params: StairsParams, fps: float
) -> Clip:
    """Climb and descend for the times t [s], the standard figure on its staircase."""
    style = draw_style(rng)
    falls, plants, step_s = _plan(params, float(t[-1]))
    return pose_figure("stairs", fps, _climber(t, rng, params, style, falls, plants, step_s))


def fit_climber(
    reference: Reference, person: Person, rng: np.random.Generator, params: StairsParams
) -> Reference:
    """Place a person's soles on the treads of a staircase scaled by the person's leg length."""
    scale, fps = leg_scale(person), reference.fps
    t = np.arange(len(reference.root)) / fps
    _, plants, step_s = _plan(params, float(t[-1]))
    below = scale * np.stack([_under(t, feet, step_s) for feet in plants], 1)  # (T, 2)
    root, R = reference.root, reference.rotations

    def raised() -> Array:
        points = sole_points(person, joint_positions(person.joints, root, R), R)
        points[..., 2] -= np.repeat(below, 2, axis=1)[:, :, None]
        return points

    root = root - np.percentile(raised()[..., 2].min((1, 2)), 8.0) * np.array([0.0, 0.0, 1.0])
    for k, side in enumerate("lr"):
        move = foot_correction(raised()[:, 2 * k : 2 * k + 2], fps)
        R = bend_limb(joint_positions(person.joints, root, R), R, side, move)
    points = raised()
    planted, touching = standing(points, fps), points[..., 2].min(-1) < 0.01
    return dataclasses.replace(
        reference, root=root, rotations=R, planted=planted, touching=touching,
        ground_boxes=stair_boxes(params, scale),
    )  # fmt: skip


def _on_level(start: float, end: float, y: float, halves: float, level: int) -> list[tuple]:
    """Two steps along x to `end`."""
    return [(start + s * (end - start), y, halves, level, 0) for s in (0.5, 1.0)]


def _around(x: float, out: float, radius: float, halves: float, level: int) -> list[tuple]:
    """Six steps of a half turn to the left, beginning in direction `out` along x."""
    rows = []
    for a in np.arange(1, 7) * np.pi / 6:
        y = radius - out * radius * np.cos(a)
        rows.append((x + out * radius * np.sin(a), y, halves + a / np.pi, level, 0))
    return rows


def _plan(
    params: StairsParams, seconds: float
) -> tuple[Footfalls, tuple[list[Plant], list[Plant]], float]:
    """The steps, the stances of the left and the right foot, and seconds between steps."""
    step_s = STEP_S * params.pace
    falls = footfalls(params, int((seconds + 4.0) / step_s) + 4)
    plants = tuple(_stances(falls, step_s, foot) for foot in (0, 1))
    return falls, plants, step_s  # pyright: ignore[reportReturnType]


def _strike(k: Array | int, step_s: float) -> Array:
    """When step k strikes; step 0 is the stand at the start."""
    return np.asarray(STARTS + (k - 0.24) * step_s)


def _stances(falls: Footfalls, step_s: float, foot: int) -> list[Plant]:
    sign = 1.0 - 2.0 * foot
    mine = [0, *range(1 + foot, len(falls.height), 2)]  # the left foot takes the odd steps
    left = np.stack([-np.sin(falls.heading), np.cos(falls.heading)], -1)
    place = falls.xy + 0.5 * sign * FEET_APART * left
    swing = (2.0 - STANCE) * step_s
    plants = []
    for n, k in enumerate(mine):
        after = mine[n + 1] if n + 1 < len(mine) else None
        off = float(_strike(after, step_s)) - swing if after is not None else np.inf
        down, up = _pitches(falls, place, mine[n - 1] if n else None, k)
        lift = _pitches(falls, place, k, after)[1] if after is not None else up
        plants.append(
            Plant(
                strike=float(_strike(k, step_s)) if k else -np.inf,
                off=off,
                place=(float(place[k, 0]), float(place[k, 1])),
                yaw=float(falls.heading[k] + 0.6 * sign * TOE_OUT),
                strike_pitch=down,
                lift_pitch=lift,
                height=float(falls.height[k]),
            )
        )
    return plants


def _pitches(falls: Footfalls, place: Array, before: int | None, after: int) -> tuple[float, float]:
    """Foot pitch of one stride [rad]: toes up at the strike, heel up at the lift."""
    if before is None:
        return 0.0, 0.0
    climb = falls.height[after] - falls.height[before]
    stride = float(np.hypot(*(place[after] - place[before]))) / (2.0 * FULL_STEP)
    if climb > 0.01:
        return 0.0, 0.45
    if climb < -0.01:
        return -0.30, 0.70
    return STRIKE_PITCH * stride, LIFT_PITCH * stride**0.7


def _under(t: Float[Array, "T"], plants: list[Plant], step_s: float) -> Float[Array, "T"]:
    """Ground height below a foot: of its stance, from mid-swing on of the next stance."""
    swing = (2.0 - STANCE) * step_s
    switch = np.array([p.strike - 0.5 * swing for p in plants[1:]])
    heights = np.array([p.height for p in plants])
    return heights[np.searchsorted(switch, t)]


def _body_path(
    t: Array, falls: Footfalls, strides: Float[Array, "K"]
) -> tuple[Array, Array, Array, Array]:
    """Pelvis position, heading, lean and downward gaze over time; `strides` are the mid-stances."""
    from scipy.interpolate import PchipInterpolator
    from scipy.ndimage import gaussian_filter1d

    up, down = falls.slope > 0, falls.slope < 0
    drop = np.select([up, down], [0.105, 0.085], 0.02)
    ahead = np.where(up, 0.03, 0.0)
    lean = np.select([up, down], [0.17, 0.05], 0.04)
    gaze = np.select([up, down], [0.30, 0.42], 0.10)
    drop[0], lean[0] = 0.006, 0.0
    knots = np.column_stack(
        [falls.xy, falls.heading, falls.height - drop, ahead, lean, np.roll(gaze, -1)]
    )
    knots = np.concatenate([knots[:1], knots])
    curve = PchipInterpolator(np.concatenate([[STARTS - 2.0], strides]), knots, extrapolate=True)
    dt = float(t[1] - t[0]) if len(t) > 1 else 1.0
    at = np.asarray(curve(np.maximum(t, STARTS - 2.0)))
    at = np.asarray(gaussian_filter1d(at, 0.06 / dt, axis=0, mode="nearest"))
    x, y, heading, z, forward, lean, gaze = at.T
    facing = np.stack([np.cos(heading), np.sin(heading)], -1)
    pelvis = np.empty((len(t), 3))
    pelvis[:, :2] = np.stack([x, y], -1) + forward[:, None] * facing
    pelvis[:, 2] = HIP_HEIGHT + 0.006 + z
    return pelvis, heading, lean, gaze


def _climber(
    t: Array,
    rng: np.random.Generator,
    params: StairsParams,
    style: Style,
    falls: Footfalls,
    plants: tuple[list[Plant], list[Plant]],
    step_s: float,
) -> Controls:
    from scipy.interpolate import PchipInterpolator

    middle = _strike(np.arange(len(falls.height)), step_s) + MIDSTANCE * step_s
    middle[0] = STARTS
    pelvis, heading, lean, gaze = _body_path(t, falls, middle)
    phase = np.pi * (t - middle[0]) / step_s
    going = np.clip((t - STARTS) / step_s, 0.0, 1.0)
    side = -np.cos(phase) * going  # +1 over the left foot, which takes the odd steps
    left = np.stack([-np.sin(heading), np.cos(heading)], -1)
    pelvis[:, :2] += 0.02 * side[:, None] * left
    edges = stair_boxes(params)
    feet = roll_feet(t, plants, step_s, lambda xy: ground_height(edges, xy, _NEAR_EDGE))
    gait = WalkParams(speed=0.75)
    wrist, flex = swinging_arms(t, np.sin(phase) * going, 0.7 * going, gait, rng)
    look = PchipInterpolator(middle, falls.heading)(np.clip(t + 0.35, middle[0], middle[-1]))
    trunk = (
        turn(yaw=heading, pitch=0.4 * lean, roll=-0.04 * side),
        turn(yaw=heading, pitch=style.slouch + lean, roll=0.02 * side),
        turn(
            yaw=look + 0.05 * slow_noise(t, rng, 0.05, 0.25),
            pitch=style.gaze_down + gaze + 0.03 * slow_noise(t, rng, 0.05, 0.3),
        ),
    )
    return gait_controls(pelvis, trunk, feet, wrist, flex)
