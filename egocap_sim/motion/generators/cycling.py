"""Riding a bicycle along a closed path: motion of bicycle and rider, and their contacts.

The bicycle's frame: x forward, y left, z up in the plane of its wheels, the origin on
the ground below the crank axle. Lengths are the standard figure's; a person's are `scale` times.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import GRAVITY, axis_angle, inverse, rigid, transform, unit
from egocap.series import interpolate
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.person import Person
from egocap_sim.motion.generators.stance import HANG, draw_style
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import slow_noise, turn
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.kinematics.limbs import bend_limb
from egocap_sim.motion.kinematics.posing import SIDES, Controls, aim_wrists, pose_figure
from egocap_sim.motion.retarget.palms import find_palm
from egocap_sim.motion.retarget.retarget import Reference

AXLE = np.array([0.0, 0.0, 0.28])  # of the cranks
CRANK, PEDAL_Y = 0.17, 0.13
WHEEL_R, REAR_X, FRONT_X = 0.34, -0.43, 0.62
PELVIS = np.array([-0.25, 0.0, 0.985])
GRIP = np.array([0.42, 0.25, 1.03])  # the left one
HEAD_TUBE = np.array([0.46, 0.0, 0.88])  # its top: with the front hub, the axis of steering
PALM = np.array([0.08, 0.0, -0.03])  # from the wrist to the palm on the bar


@dataclass(frozen=True)
class CycleParams:
    """A ride along a rounded closed path."""

    ride_speed: Annotated[float, (2.0, 8.0)] = 4.5
    """Speed in m/s of the standard figure; it scales with leg length."""
    ride_radius: Annotated[float, (4.0, 12.0)] = 7.0
    """Mean distance from the origin in metres."""
    cadence: Annotated[float, (40.0, 110.0)] = 75.0
    """Crank revolutions per minute."""


class Ride:
    """Pose of the bicycle and its parts at any time."""

    def __init__(self, rng: np.random.Generator, params: CycleParams) -> None:
        self.params = params
        self._crank = float(rng.uniform(0.0, 2.0 * np.pi))
        phase, start = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.0, 2.0 * np.pi)
        self._side = float(rng.choice([-1.0, 1.0]))  # +1 turns left
        a = start + np.arange(-8, 4001 + 8) * (2.0 * np.pi / 4000)  # slightly more than one round
        r = 1.0 + 0.10 * np.sin(2 * a + phase[0]) + 0.03 * np.sin(3 * a + phase[1])
        xy = params.ride_radius * r[:, None] * np.stack([np.cos(a), self._side * np.sin(a)], -1)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        heading = np.unwrap(np.arctan2(*np.gradient(xy, axis=0)[:, ::-1].T))
        bend = np.gradient(heading, s)
        self._xy, self._heading, self._bend = xy[8:-8], heading[8:-8], bend[8:-8]
        self._s = s[8:-8] - s[8]

    def distance(self, t: Float[Array, "T"]) -> Float[Array, "T"]:
        """Metres ridden by the figure; a person rides `scale` times as far."""
        return self.params.ride_speed * t

    def crank(self, t: Float[Array, "T"]) -> Float[Array, "T"]:
        """Angle of the left crank, radians: 0 up, increasing when riding forward."""
        return self._crank + 2.0 * np.pi * self.params.cadence / 60.0 * t

    def pose(self, t: Float[Array, "T"], scale: float = 1.0) -> Float[Array, "T 4 4"]:
        """World poses of the bicycle, leaning into the curves."""
        s = self.distance(t) % self._s[-1]
        xy = scale * interpolate(s, self._s, self._xy)
        heading = np.interp(s, self._s, self._heading)
        return rigid(turn(yaw=heading, roll=-self.lean(t)), np.pad(xy, ((0, 0), (0, 1))))

    def lean(self, t: Float[Array, "T"]) -> Float[Array, "T"]:
        """Lean to the left [rad] that balances the centripetal force."""
        return np.arctan(self.params.ride_speed**2 * self._bent(t) / -GRAVITY[2])

    def steering(self, t: Float[Array, "T"], scale: float = 1.0) -> Float[Array, "T 4 4"]:
        """Transforms of the front fork about its axis, in the bicycle's frame."""
        hub = scale * np.array([FRONT_X, 0.0, WHEEL_R])
        axis = unit(scale * HEAD_TUBE - hub)
        R = axis_angle(axis, np.arctan((FRONT_X - REAR_X) * self._bent(t)))
        return rigid(R, hub - R @ hub)

    def pedals(self, t: Float[Array, "T"], scale: float = 1.0) -> Float[Array, "T 2 3"]:
        """Tops of the pedals, left and right, in the bicycle's frame."""
        out = np.empty((len(t), 2, 3))
        for i, (_, sign) in enumerate(SIDES):
            a = self.crank(t) + np.pi * i
            out[:, i] = AXLE + CRANK * np.stack([np.sin(a), 0.0 * a, np.cos(a)], -1)
            out[:, i, 1] = sign * PEDAL_Y
        return scale * out

    def _bent(self, t: Float[Array, "T"]) -> Float[Array, "T"]:
        return np.interp(self.distance(t) % self._s[-1], self._s, self._bend)


def cycle(t: Float[Array, "T"], rng: np.random.Generator, params: CycleParams, fps: float) -> Clip:
    """Ride for the times t [s], the standard figure on its bicycle, in the world."""
    ride = Ride(rng, params)
    style = draw_style(rng)
    rides = pose_figure("cycle", fps, _rider(t, ride, rng, style.gaze_down))
    T_world_bike = ride.pose(t)
    R = T_world_bike[:, None, :3, :3]
    return dataclasses.replace(
        rides, positions=transform(T_world_bike, rides.positions), rotations=R @ rides.rotations
    )


def fit_rider(
    reference: Reference, person: Person, rng: np.random.Generator, params: CycleParams
) -> Reference:
    """Put the balls of a person's feet on the pedals and the palms on the grips."""
    ride, scale = Ride(rng, params), leg_scale(person)
    t = np.arange(len(reference.root)) / reference.fps
    T_world_bike, steering = ride.pose(t, scale), ride.steering(t, scale)
    R = reference.rotations
    pedals = transform(T_world_bike, ride.pedals(t, scale))
    for i, side in enumerate("lr"):
        p = joint_positions(person.joints, reference.root, R)
        R = bend_limb(p, R, side, pedals[:, i] - _ball_of_foot(person, p, R, side))
    grips = grip_positions(
        person, joint_positions(person.joints, reference.root, R), R, T_world_bike @ steering
    )
    held = transform(T_world_bike @ steering, np.broadcast_to(grips, (len(t), 2, 3)))
    for i, side in enumerate("lr"):
        p = joint_positions(person.joints, reference.root, R)
        R = bend_limb(p, R, side, held[:, i] - _palm(person, p, R, side), arm=True)
    return dataclasses.replace(reference, rotations=R)


def grip_positions(
    person: Person,
    positions: Float[Array, "T 21 3"],
    rotations: Float[Array, "T 21 3 3"],
    T_world_bar: Float[Array, "T 4 4"],
) -> Float[Array, "2 3"]:
    """Symmetric grip positions at a rider's palms, in the bar's frame."""
    palms = np.stack([_palm(person, positions, rotations, side) for side in "lr"], 1)
    local = transform(inverse(T_world_bar), palms).mean(0)
    left = (local[0] + local[1] * [1.0, -1.0, 1.0]) / 2
    return np.stack([left, left * [1.0, -1.0, 1.0]])


def leg_scale(person: Person) -> float:
    """Ratio of a person's leg length to the figure's."""
    chain = [INDEX[f"l_{part}"] for part in ("thigh", "calf", "foot")]
    lengths = [np.linalg.norm(np.diff(p[chain], axis=0), axis=1).sum()
               for p in (person.joints, figure.REST)]  # fmt: skip
    return float(lengths[0] / lengths[1])


def _rider(t: Float[Array, "T"], ride: Ride, rng: np.random.Generator, gaze: float) -> Controls:
    """The figure in the bicycle's frame."""
    n, pedals, crank = len(t), ride.pedals(t), ride.crank(t)
    ankle, foot_R = np.empty((n, 2, 3)), np.empty((n, 2, 3, 3))
    for i in range(2):
        pitch = 0.28 - 0.20 * np.cos(crank + np.pi * i + 0.4)  # heel lowest over the top
        foot_R[:, i] = turn(pitch=pitch)
        ankle[:, i] = pedals[:, i] - foot_R[:, i] @ figure.SOLE_BALL
    sway = 0.03 * np.sin(crank) + 0.01 * slow_noise(t, rng, 0.1, 0.5)
    look = 0.12 * slow_noise(t, rng, 0.05, 0.3)
    controls = Controls(
        pelvis=PELVIS + np.stack([0 * t, 0.012 * np.sin(crank), 0 * t], -1),
        pelvis_R=turn(pitch=np.full(n, 0.30), roll=0.5 * sway),
        chest_R=turn(pitch=0.52 + 0.02 * slow_noise(t, rng, 0.05, 0.3), roll=sway),
        head_R=turn(yaw=look, pitch=gaze + 0.05, roll=0.6 * ride.lean(t)),
        ankle=ankle,
        foot_R=foot_R,
        toe=np.zeros((n, 2)),
        wrist=np.tile(np.stack([HANG * [1.0, sign, 1.0] for _, sign in SIDES]), (n, 1, 1)),
        pronation=np.full((n, 2), 1.35),
        wrist_bend=np.full((n, 2), 0.30),
        swivel=np.full((n, 2), 0.15),
    )
    grips = np.stack([GRIP * [1.0, sign, 1.0] for _, sign in SIDES])
    held = transform(ride.steering(t), np.broadcast_to(grips, (n, 2, 3)))
    return aim_wrists(controls, held - PALM)


def _palm(person: Person, p: Array, R: Array, side: str) -> Float[Array, "T 3"]:
    palm = find_palm(person, side)
    return p[:, palm.body] + R[:, palm.body] @ palm.centre


def _ball_of_foot(person: Person, p: Array, R: Array, side: str) -> Float[Array, "T 3"]:
    """Sole under the toe joint."""
    foot, toe = INDEX[f"{side}_foot"], INDEX[f"{side}_toe"]
    sole = person.joints[toe] - person.joints[foot]
    return p[:, foot] + R[:, foot] @ (sole - [0.0, 0.0, person.joints[toe, 2]])
