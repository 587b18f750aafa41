"""Balls in flight between hands and floor: exact parabolas that start and end at the palms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.geometry import GRAVITY, rigid
from egocap_sim.assets import primitives
from egocap_sim.assets.mesh import AnimatedActor
from egocap_sim.assets.textures import SIZE, noise
from egocap_sim.core import part_labels
from egocap_sim.motion.generators.ball_handling import (
    BALLS,
    FLIGHT_S,
    PUSH_S,
    Touch,
    plan_cascade,
    plan_touches,
)
from egocap_sim.props.performance import Performance
from egocap_sim.props.rigid_actor import moving
from egocap_sim.scene.config import ThingTable

BASKETBALL_R, JUGGLING_R = 0.12, 0.034  # metres
BOUNCE = 0.85  # speed kept at the floor, of a basketball on a hard court
_G = -float(GRAVITY[2])


def basketball(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """A ball that is dribbled: held, pushed, bouncing off the floor, caught again."""
    start, times = performance.start_s, performance.times
    plan = plan_touches(performance.rng, performance.parameters, start + float(times[-1]))
    plan = [Touch(k.caught - start, k.pushed - start, k.hand) for k in plan]
    centre = _centres(performance, BASKETBALL_R)
    path = np.empty((len(times), 3))
    for touch, after in pairwise(plan):
        held = (times >= touch.caught) & (times < touch.pushed)
        path[held] = performance.held(touch.hand, centre[touch.hand])[held]
        flies = (times >= touch.pushed) & (times < after.caught)
        if flies.any():
            a, b = (
                performance.held_at(hand, centre[hand], np.array([when]), PUSH_S + FLIGHT_S)[0]
                for hand, when in ((touch.hand, touch.pushed), (after.hand, after.caught))
            )
            path[flies] = bounced(a, b, times[flies] - touch.pushed, after.caught - touch.pushed)
    spin = rng.normal(size=3)
    return [_ball("ball", BASKETBALL_R, _leather(rng), path, times, spin)]


def juggled(
    thing: ThingTable, performance: Performance, rng: np.random.Generator
) -> list[AnimatedActor]:
    """Three balls in a cascade."""
    timing = plan_cascade(performance.rng, performance.parameters)
    times, first = performance.times, timing.first - performance.start_s
    centre = _centres(performance, JUGGLING_R)
    period = 2.0 * timing.beat
    number = np.floor((times - first) / timing.beat).astype(int)  # the last throw of any ball
    extras = []
    for k in range(BALLS):
        path = np.empty((len(times), 3))
        thrown = number - (number - k) % BALLS  # the last throw of this ball
        for n in np.unique(thrown):
            now, off = thrown == n, first + n * timing.beat
            a, b = int(n % 2), int((n + 1) % 2)
            ends = off, off + timing.flight
            p, q = (
                performance.held_at(hand, centre[hand], np.array([when]), period)[0]
                for hand, when in zip((a, b), ends, strict=True)
            )
            flies = now & (times < ends[1])
            path[flies] = thrown_path(p, q, times[flies] - off, timing.flight)
            caught = now & ~flies
            path[caught] = performance.held(b, centre[b])[caught]
        texture = _beanbag(rng)
        extras.append(_ball(f"ball-{k + 1}", JUGGLING_R, texture, path, times, rng.normal(size=3)))
    return extras


def thrown_path(
    start: Float[Array, "3"], end: Float[Array, "3"], t: Float[Array, "N"], flight: float
) -> Float[Array, "N 3"]:
    """Free flight from one point to another in `flight` seconds, at times t since the throw."""
    straight = start + (t / flight)[:, None] * (end - start)
    straight[:, 2] += 0.5 * _G * t * (flight - t)
    return straight


def bounced(
    start: Float[Array, "3"],
    end: Float[Array, "3"],
    t: Float[Array, "N"],
    flight: float,
    radius: float = BASKETBALL_R,
) -> Float[Array, "N 3"]:
    """A ball pushed down, bouncing once, and back up to `end` in `flight` seconds.

    The push is as hard as the bounce needs: found by bisection so that the floor gives back
    `BOUNCE` of the speed, or as near to that as the time allows.
    """
    high, low = start[2] - radius, end[2] - radius

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
    path[:, 2] = radius + np.where(t < floor, falling, rising)
    return path


def _centres(performance: Performance, radius: float) -> list[Float[Array, "3"]]:
    """A ball's middle in each hand's frame while it lies in the palm."""
    return [palm.centre + radius * palm.normal for palm in performance.palms]


def _ball(name, radius, texture, path, times, spin) -> AnimatedActor:
    mesh = primitives.ball(
        name, (0, 0, 0), (radius,) * 3, texture, 2 * np.pi * radius, part=part_labels.OBJECT,
        shininess=0.15, rings=12,
    )  # fmt: skip
    turned = Rotation.from_rotvec(np.outer(times, spin)).as_matrix()
    return moving(name, [(0, mesh)], rigid(turned, path)[:, None])


def _leather(rng: np.random.Generator) -> Array:
    """Orange, with dark seams."""
    v, u = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    seam = np.minimum.reduce([
        np.abs((u * 4) % 1.0 - 0.5) / 4 * np.sin(np.pi * v), np.abs(v - 0.5),
        np.abs(np.abs(v - 0.5) - 0.22 - 0.05 * np.cos(4 * np.pi * u)),
    ]) < 0.008  # fmt: skip
    colour = np.array([0.80, 0.40, 0.16]) * (1 + 0.05 * noise(rng, 30, 200, 0.2))[..., None]
    return _bytes(np.where(seam[..., None], 0.12, colour))


def _beanbag(rng: np.random.Generator) -> Array:
    """Panels of two bright colours."""
    u = np.arange(64)[None, :] * 4 // 64 % 2
    one, two = rng.uniform(0.1, 0.95, (2, 3))
    return _bytes(np.broadcast_to(np.where(u[..., None] > 0, one, two), (64, 64, 3)))


def _bytes(colour: Array) -> Array:
    return np.round(np.clip(colour, 0, 1) * 255).astype(np.uint8)
