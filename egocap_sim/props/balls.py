"""Balls that fly between palms and floor on exact parabolas."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.geometry import GRAVITY, rigid
from egocap_sim.assets.mesh import AnimatedActor, Material, moving
from egocap_sim.assets.primitives import ball
from egocap_sim.assets.textures import SIZE, noise, to_bytes
from egocap_sim.core.part_labels import OBJECT
from egocap_sim.motion.generators.ball_handling import (
    BALLS,
    FLIGHT_S,
    PUSH_S,
    Touch,
    plan_cascade,
    plan_touches,
)
from egocap_sim.props.performance import Performance

BASKETBALL_R, JUGGLING_R = 0.12, 0.034  # metres
BOUNCE = 0.85  # coefficient of restitution of a basketball on a hard court
_G = -float(GRAVITY[2])
Rng = np.random.Generator


def basketball(performance: Performance, rng: Rng) -> list[AnimatedActor]:
    """A dribbled ball: held, pushed, bouncing off the floor, caught."""
    start, times = performance.start_s, performance.times
    plan = plan_touches(performance.rng, performance.parameters, start + float(times[-1]))
    plan = [Touch(k.caught - start, k.pushed - start, k.hand) for k in plan]
    hands = _Hands(performance, BASKETBALL_R, PUSH_S + FLIGHT_S)
    path = np.empty((len(times), 3))
    for touch, after in pairwise(plan):
        held = (times >= touch.caught) & (times < touch.pushed)
        path[held] = hands.paths[touch.hand][held]
        flies = (times >= touch.pushed) & (times < after.caught)
        if flies.any():
            a, b = hands.at(touch.hand, touch.pushed), hands.at(after.hand, after.caught)
            path[flies] = bounced(a, b, times[flies] - touch.pushed, after.caught - touch.pushed)
    spin = rng.normal(size=3)
    return [_ball("ball", BASKETBALL_R, _leather(rng), path, times, spin)]


def juggling_balls(performance: Performance, rng: Rng) -> list[AnimatedActor]:
    """Three balls in a cascade."""
    timing = plan_cascade(performance.rng, performance.parameters)
    times, first = performance.times, timing.first - performance.start_s
    hands = _Hands(performance, JUGGLING_R, 2.0 * timing.beat)
    number = np.floor((times - first) / timing.beat).astype(int)  # the last throw of any ball
    actors = []
    for k in range(BALLS):
        path = np.empty((len(times), 3))
        thrown = number - (number - k) % BALLS  # the last throw of this ball
        for n in np.unique(thrown):
            now, off = thrown == n, first + n * timing.beat
            a, b, lands = int(n % 2), int((n + 1) % 2), off + timing.flight
            flies = now & (times < lands)
            ends = hands.at(a, off), hands.at(b, lands)
            path[flies] = thrown_path(*ends, times[flies] - off, timing.flight)
            caught = now & ~flies
            path[caught] = hands.paths[b][caught]
        texture = _beanbag(rng)
        actors.append(_ball(f"ball-{k + 1}", JUGGLING_R, texture, path, times, rng.normal(size=3)))
    return actors


class _Hands:
    """Positions of a ball held in each palm; `period` is that of the motion (s)."""

    def __init__(self, performance: Performance, radius: float, period: float) -> None:
        self.performance, self.period = performance, period
        self.offsets = [palm.centre + radius * palm.normal for palm in performance.palms]
        self.paths = [performance.held(h, offset) for h, offset in enumerate(self.offsets)]

    def at(self, hand: int, when: float) -> Float[Array, "3"]:
        times = np.array([when])
        return self.performance.held_at(hand, self.offsets[hand], times, self.period)[0]


def thrown_path(
    start: Float[Array, "3"], end: Float[Array, "3"], t: Float[Array, "N"], flight: float
) -> Float[Array, "N 3"]:
    """Free flight between two points in `flight` seconds, at times t since the throw."""
    straight = start + (t / flight)[:, None] * (end - start)
    straight[:, 2] += 0.5 * _G * t * (flight - t)
    return straight


def bounced(
    start: Float[Array, "3"], end: Float[Array, "3"], t: Float[Array, "N"], flight: float
) -> Float[Array, "N 3"]:
    """Path of a ball pushed down from `start` that bounces once and reaches `end` after `flight` s.

    Bisection finds the initial speed for which the restitution is `BOUNCE`, or as close to it as
    the time of flight allows.
    """
    high, low = start[2] - BASKETBALL_R, end[2] - BASKETBALL_R

    def down_time(push: float) -> float:
        return float((np.sqrt(push * push + 2.0 * _G * high) - push) / _G)

    def kept(push: float) -> float:
        rise = flight - down_time(push)
        return (low / rise + 0.5 * _G * rise) / (push + _G * down_time(push)) if rise > 0 else 9.9

    slow, fast = 0.0, 12.0
    for _ in range(60):
        push = 0.5 * (slow + fast)
        slow, fast = (push, fast) if kept(push) > BOUNCE else (slow, push)
    push = 0.5 * (slow + fast)
    floor = down_time(push)
    rise = flight - floor
    up = low / rise + 0.5 * _G * rise
    since = t - floor
    falling = high - push * t - 0.5 * _G * t * t
    rising = up * since - 0.5 * _G * since * since
    path = start + (t / flight)[:, None] * (end - start)
    path[:, 2] = BASKETBALL_R + np.where(t < floor, falling, rising)
    return path


def _ball(
    name: str, radius: float, texture: Array, path: Array, times: Array, spin: Array
) -> AnimatedActor:
    skin = Material(texture, 2 * np.pi * radius, shininess=0.15, part=OBJECT)
    mesh = ball(name, (0, 0, 0), (radius,) * 3, skin, rings=12)
    turned = Rotation.from_rotvec(np.outer(times, spin)).as_matrix()
    return moving(name, [(0, mesh)], rigid(turned, path)[:, None])


def _leather(rng: Rng) -> UInt8[Array, "S S 3"]:
    """Texture of a basketball: orange, with dark seams."""
    v, u = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    seam = np.minimum.reduce([
        np.abs((u * 4) % 1.0 - 0.5) / 4 * np.sin(np.pi * v), np.abs(v - 0.5),
        np.abs(np.abs(v - 0.5) - 0.22 - 0.05 * np.cos(4 * np.pi * u)),
    ]) < 0.008  # fmt: skip
    colour = np.array([0.80, 0.40, 0.16]) * (1 + 0.05 * noise(rng, 30, 200, 0.2))[..., None]
    return to_bytes(np.where(seam[..., None], 0.12, colour))


def _beanbag(rng: Rng) -> UInt8[Array, "64 64 3"]:
    """Texture of panels in two colours."""
    u = np.arange(64)[None, :] * 4 // 64 % 2
    one, two = rng.uniform(0.1, 0.95, (2, 3))
    return to_bytes(np.broadcast_to(np.where(u[..., None] > 0, one, two), (64, 64, 3)))
