"""Walking courses of bystanders: from goal to goal near the wearer, avoiding people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.series import interpolate
from egocap_sim.motion.generators.course import Course, course_times

PASS_M = 0.75  # least distance between the centres of two people
AVOID_M = 1.5  # distance at which avoidance begins
TURN = 1.2  # 1/m, the largest curvature
WAYS = 48  # candidates simulated at once
_BEST = 6  # candidates returned
_GOAL_S = 5.0  # time after which a goal is replaced
_RATE = 30.0


def free_courses(
    rng: np.random.Generator,
    times: Float[Array, "T"],
    people: Sequence[Float[Array, "T 2"]],
    speed: float,
    bounds_m: float,
    near_m: float,
    scale: float,
) -> Iterator[Course]:
    """Courses that keep clear of people (the first is the wearer), best first.

    They are ranked by the time spent within `near_m` of the wearer. Course lengths are world
    metres divided by `scale`. Yields nothing when the place is too narrow.
    """
    t = course_times(float(times[-1] - times[0]), _RATE)
    walkers = np.stack([_at(path, times, t) for path in people], 1)  # (N, M, 2)
    xy, heading = _walk(rng, t, walkers, speed, bounds_m)
    lasts = (t >= 0) & (t <= times[-1] - times[0])
    inside, others = xy[lasts], walkers[lasts]
    distance = np.linalg.norm(inside[:, :, None] - others[:, None], axis=-1)  # (n, K, M)
    good = (distance.min((0, 2)) >= PASS_M) & (np.linalg.norm(inside, axis=-1).max(0) <= bounds_m)
    nearness = (distance[:, :, 0] < near_m).mean(0)
    order = np.argsort(-nearness, kind="stable")
    step_s = Course(t, xy[:, 0], heading[:, 0], np.ones(len(t)), speed / scale, 0, 0).step_s
    for k in [k for k in order if good[k]][:_BEST]:
        yield Course(
            t, xy[:, k] / scale, heading[:, k], np.ones(len(t)), speed / scale,
            starts=-2.3 * step_s, ends=float(times[-1] - times[0]) + 1.0,
        )  # fmt: skip


def _at(path: Array, times: Array, t: Array) -> Float[Array, "N 2"]:
    return interpolate(t, times - times[0], path[:, :2])


def _walk(
    rng: np.random.Generator,
    t: Float[Array, "N"],
    people: Float[Array, "N M 2"],
    speed: float,
    bounds_m: float,
) -> tuple[Float[Array, "N K 2"], Float[Array, "N K"]]:
    """Positions and headings of K candidates steered from goal to goal."""
    angle = rng.uniform(-np.pi, np.pi, WAYS)
    p = rng.uniform(0.4, 1.0, (WAYS, 1)) * bounds_m * np.stack([np.cos(angle), np.sin(angle)], -1)
    heading = angle + np.pi + rng.normal(0, 0.5, WAYS)
    goal, left, bend = np.zeros((WAYS, 2)), np.zeros(WAYS), np.zeros(WAYS)
    xy, headings = np.empty((len(t), WAYS, 2)), np.empty((len(t), WAYS))
    step = speed / _RATE
    for n in range(len(t)):
        xy[n], headings[n] = p, heading
        renew = (left <= 0) | (np.linalg.norm(goal - p, axis=1) < 0.5)
        if renew.any():
            goal[renew] = _goals(rng, int(renew.sum()), p[renew], people[n, 0], bounds_m)
            left[renew] = _GOAL_S
        left -= 1 / _RATE
        wanted = 1.5 * _turn_to(goal - p, heading)
        for m in range(people.shape[1]):
            wanted += _avoidance(people[n, m] - p, heading)
        out = np.linalg.norm(p, axis=1) > bounds_m - 0.5
        wanted = np.where(out, 3.0 * _turn_to(-p, heading), wanted)
        bend += (np.clip(wanted, -TURN, TURN) - bend) * min(1.0, step / 0.2)
        heading = heading + bend * step
        p = p + step * np.stack([np.cos(heading), np.sin(heading)], -1)
    return xy, headings


def _goals(
    rng: np.random.Generator, count: int, p: Array, wearer: Array, bounds_m: float
) -> Float[Array, "C 2"]:
    """Goals beyond the wearer, offset to the side, within the bounds."""
    across = wearer - p
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    side = np.stack([-across[:, 1], across[:, 0]], -1)
    lateral = rng.choice([-1.0, 1.0], (count, 1)) * rng.uniform(0.9, 1.8, (count, 1))
    goal = wearer + rng.uniform(0.8, 2.5, (count, 1)) * across + lateral * side
    far = np.linalg.norm(goal, axis=1, keepdims=True)
    return goal * np.minimum(1.0, (bounds_m - 0.6) / np.maximum(far, 1e-6))


def _turn_to(way: Float[Array, "K 2"], heading: Float[Array, "K"]) -> Float[Array, "K"]:
    error = np.arctan2(way[:, 1], way[:, 0]) - heading
    return (error + np.pi) % (2 * np.pi) - np.pi


def _avoidance(way: Float[Array, "K 2"], heading: Float[Array, "K"]) -> Float[Array, "K"]:
    """Curvature that turns away from a person ahead; it grows as the distance `way` shrinks."""
    distance = np.linalg.norm(way, axis=1)
    angle = _turn_to(way, heading)
    strength = np.clip((AVOID_M - distance) / (AVOID_M - 0.5), 0.0, 1.0) * (np.cos(angle) > -0.3)
    return -3.0 * strength * np.where(angle >= 0, 1.0, -1.0)
