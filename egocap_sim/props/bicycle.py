"""A bicycle under a rider: frame, fork with handlebar, wheels, cranks and pedals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from egocap.geometry import LEFT, axis_angle, inverse, rigid, transform
from egocap_sim.assets import textures
from egocap_sim.assets.mesh import AnimatedActor, Material, Mesh, moving
from egocap_sim.assets.primitives import ball, box, ring, tube
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import OBJECT
from egocap_sim.motion.generators.cycling import (
    AXLE,
    CRANK,
    FRONT_X,
    HEAD_TUBE,
    PEDAL_Y,
    REAR_X,
    WHEEL_R,
    Ride,
    grip_positions,
    leg_scale,
)
from egocap_sim.props.performance import Performance

FRAME, FORK, FRONT, REAR, CRANKS, LEFT_PEDAL, RIGHT_PEDAL = range(7)
_BAR_R, _TYRE_R = 0.014, 0.018  # metres


def bicycle(performance: Performance, rng: np.random.Generator) -> list[AnimatedActor]:
    """The bicycle that the wearer rides, fitted to the wearer."""
    ride, scale = Ride(performance.rng, performance.parameters), leg_scale(performance.person)
    t = performance.times + performance.start_s
    T_world_bike, steering = ride.pose(t, scale), ride.steering(t, scale)
    T = performance.bodies
    grips = grip_positions(
        performance.person, T[..., :3, 3], T[..., :3, :3], T_world_bike @ steering
    )
    bar = grips[0] - [0.0, 0.0, _BAR_R]  # under the left palm
    parts = {
        FRAME: _frame(scale, _saddle_top(performance, T_world_bike), rng),
        FORK: _fork(scale, bar),
        FRONT: _wheel(scale),
        REAR: _wheel(scale),
    }
    meshes = [(part, mesh) for part, made in parts.items() for mesh in made]
    transforms = T_world_bike[:, None] @ _moving_parts(ride, t, scale, steering)
    return [moving("bicycle", [*meshes, *_cranks(scale)], transforms)]


def _moving_parts(
    ride: Ride, t: Float[Array, "T"], scale: float, steering: Float[Array, "T 4 4"]
) -> Float[Array, "T 7 4 4"]:
    """Poses of the parts in the bicycle's frame."""
    out = np.tile(np.eye(4), (len(t), 7, 1, 1))
    rolled = axis_angle(LEFT, ride.distance(t) / WHEEL_R)
    out[:, FORK] = steering
    out[:, FRONT] = steering @ rigid(rolled, scale * np.array([FRONT_X, 0.0, WHEEL_R]))
    out[:, REAR] = rigid(rolled, scale * np.array([REAR_X, 0.0, WHEEL_R]))
    out[:, CRANKS] = rigid(axis_angle(LEFT, ride.crank(t)), scale * AXLE)
    for i, pedal in enumerate((LEFT_PEDAL, RIGHT_PEDAL)):
        out[:, pedal, :3, 3] = ride.pedals(t, scale)[:, i]
    return out


def _saddle_top(performance: Performance, T_world_bike: Float[Array, "T 4 4"]) -> Float[Array, "3"]:
    """Top of the saddle in the bicycle's frame: under the lowest skin of the pelvis."""
    person, pelvis = performance.person, performance.bodies[0, INDEX["pelvis"]]
    skin = person.body_vertices[person.body_owner == INDEX["pelvis"]] - person.joints[0]
    local = transform(inverse(T_world_bike[0]) @ pelvis, skin)
    middle = transform(inverse(T_world_bike[0]), pelvis[None, :3, 3])[0]
    inner = np.abs(local[:, 1]) < 0.08
    near = local[inner] if inner.any() else local
    return np.array([middle[0] - 0.03, 0.0, float(near[:, 2].min()) + 0.02])


def _frame(scale: float, seat: Float[Array, "3"], rng: np.random.Generator) -> list[Mesh]:
    paint, dark = _even(rng.uniform(0.1, 0.8, 3)), _even(0.12, 0.0)
    axle, head = scale * AXLE, scale * HEAD_TUBE
    hub = scale * np.array([REAR_X, 0.0, WHEEL_R])
    low = head + 0.35 * (scale * np.array([FRONT_X, 0.0, WHEEL_R]) - head)
    clamp = axle + 0.75 * (seat - axle)
    pairs = [(axle, clamp, 0.018), (clamp, seat - [0, 0, 0.03], 0.013), (head, low, 0.02),
             (clamp, head - [0, 0, 0.05], 0.017), (axle, low, 0.021)]  # fmt: skip
    for y in (-0.06, 0.06):
        side = np.array([0.0, y, 0.0])
        pairs += [(axle + 0.5 * side, hub + side, 0.01), (clamp, hub + side, 0.008)]
    return [
        *(tube("frame", a, b, r, paint) for a, b, r in pairs),
        ball("saddle", seat - [0.0, 0.0, 0.03], (0.14, 0.075, 0.03), dark),
        ball("saddle", seat + [0.1, 0.0, -0.035], (0.12, 0.03, 0.025), dark),
    ]


def _fork(scale: float, bar: Float[Array, "3"]) -> list[Mesh]:
    metal, rubber = _even(0.7), _even(0.1)
    head, hub = scale * HEAD_TUBE, scale * np.array([FRONT_X, 0.0, WHEEL_R])
    low = head + 0.35 * (hub - head)
    middle = bar * [1.0, 0.0, 1.0]
    meshes = [tube("stem", head, middle, 0.014, metal)]
    for sign in (-1.0, 1.0):
        leg = np.array([0.0, 0.055 * sign, 0.0])
        end = middle + [0.0, sign * (bar[1] + 0.07), 0.0]
        inner = middle + [0.0, sign * (bar[1] - 0.06), 0.0]
        meshes += [
            tube("fork", low + leg, hub + leg, 0.012, metal),
            tube("bar", middle, end, 0.9 * _BAR_R, metal),
            tube("grip", inner, end, _BAR_R, rubber),
        ]
    return meshes


def _wheel(scale: float) -> list[Mesh]:
    """Tyre and spokes about the hub."""
    metal, r = _even(0.75), scale * WHEEL_R - _TYRE_R
    out = [
        ring("tyre", r, _TYRE_R, _even(0.1, 0.0)),
        tube("hub", (0, -0.05, 0), (0, 0.05, 0), 0.025, metal),
    ]
    for a in 2 * np.pi * np.arange(8) / 8:
        rim = r * np.array([np.sin(a), 0.0, np.cos(a)])
        out.append(tube("spoke", (0, 0, 0), rim, 0.003, metal, sides=4))
    return out


def _cranks(scale: float) -> list[tuple[int, Mesh]]:
    metal = _even(0.5)
    out = [
        (CRANKS, ring("chain ring", 0.09, 0.008, _even(0.5, 0.0))),
        (CRANKS, tube("axle", (0, -0.07, 0), (0, 0.07, 0), 0.02, metal)),
    ]
    plate = box("pedal", (0.0, 0.0, -0.012), (0.10, 0.085, 0.024), _even(0.15, 0.0))
    for pedal, sign in ((LEFT_PEDAL, 1.0), (RIGHT_PEDAL, -1.0)):
        arm = np.array([0.0, 0.07 * sign, 0.0])
        end = scale * np.array([0.0, PEDAL_Y * sign - 0.05 * sign, CRANK * sign])
        out += [(CRANKS, tube("crank", arm, end, 0.012, metal)), (pedal, plate)]
    return out


def _even(colour: ArrayLike, shininess: float = 0.3) -> Material:
    return replace(textures.even(colour), shininess=shininess, part=OBJECT)
