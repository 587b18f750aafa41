"""Tracking control of a simulated person.

Computed torque: M (qacc + feedback) + bias gives the generalised forces of the motion. The six at
the free root have no actuator; contact forces of the floor on the feet are planned to supply them
(non-negative least squares over the edges of the friction pyramids at the contact points). The
planned forces are subtracted from the joint torques too. The rest is a residual wrench on the root.

Source: one-step-ahead feedback from J. Tan et al., "Stable proportional-derivative controllers",
IEEE CG&A 31 (2011).
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap_sim.core.bodies import FEET, INDEX
from egocap_sim.physics.contact_forces import contact_forces
from egocap_sim.physics.model import FRICTION
from egocap_sim.physics.reference import Target

_PLAN_EVERY = 2  # steps between two plans
_SIDE = np.array([0, 0, 1, 1])  # of the feet, as egocap_sim.core.bodies.FEET


@dataclass(frozen=True)
class ControlConfig:
    """Gains of the tracking controller."""

    joint_rate: float = 30.0  # rad/s: natural frequency of the critically damped joint feedback
    root_rate: float = 30.0  # rad/s: the same for the root
    friction: float = 0.6  # slope of the planned friction pyramid, below that of the floor
    torque_weight: float = 4.0  # weight of the root's torques against its forces, 1/m
    regularisation: float = 0.02  # of planned contact forces: spreads them over the contact points
    plan_filter_s: float = 0.01  # time constant of the planned contact forces
    slip: float = 0.1  # factor on the friction of a sliding foot
    release_rad: float = 0.1  # contact of a foot is off while a joint error of its leg is larger


class Controller:
    """Tracking controller of one model, with the filtered contact plan as state."""

    def __init__(self, model: mujoco.MjModel, config: ControlConfig) -> None:
        self._model, self._config = model, config
        dt, nv = model.opt.timestep, model.nv
        rate = np.full(nv, config.joint_rate)
        rate[:6] = config.root_rate
        # Feedback evaluated one step ahead, so that any gain is stable.
        self._damping = 2 * rate / (1 + 2 * rate * dt + (rate * dt) ** 2)
        self._stiffness = rate**2 / (1 + 2 * rate * dt + (rate * dt) ** 2)
        self._blend = min(1.0, dt / config.plan_filter_s)
        self._foot_body = [INDEX[foot] + 1 for foot in FEET]
        self._foot_geom = np.array([model.geom(foot).id for foot in FEET])
        self._leg_dofs = np.array([_leg_dofs(model, side) for side in ("l", "r")])
        self._plan = np.zeros((len(FEET), 6))
        self._goal, self._steps = self._plan.copy(), 0
        self._open, self._grip = np.zeros(len(FEET), bool), np.ones(len(FEET))
        self._error, self._inertia = np.zeros(nv), np.zeros(nv)

    def gate(self, planted: Bool[Array, "4"], touching: Bool[Array, "4"]) -> None:
        """Enable floor contact of feet that stand or slide in the motion and are near their target.

        Friction on a misplaced foot would drag the whole person off the motion. Sliding feet have
        reduced friction.
        """
        astray = np.abs(self._error[self._leg_dofs]).max(1) > self._config.release_rad
        self._open = (planted | touching) & ~astray[_SIDE]
        self._grip = np.where(planted, 1.0, self._config.slip)
        self._model.geom_conaffinity[self._foot_geom] = self._open
        self._model.geom_friction[self._foot_geom, 0] = FRICTION * self._grip

    def apply(self, data: mujoco.MjData, target: Target, i: int) -> None:
        """Set the generalised forces for step i of a block; positions must be up to date.

        data.qfrc_applied[:6] is then the residual wrench on the root.
        """
        model, dt = self._model, self._model.opt.timestep
        mujoco.mj_differentiatePos(model, self._error, 1.0, data.qpos, target.qpos[i])
        lag = target.qvel[i] - data.qvel
        wanted = target.qacc[i] + self._stiffness * (self._error + dt * lag) + self._damping * lag
        mujoco.mj_mulM(model, data, self._inertia, wanted)
        force = self._inertia + data.qfrc_bias - data.qfrc_passive
        if self._steps % _PLAN_EVERY == 0:
            self._goal = self._planned_forces(data, force[:6])
        self._steps += 1
        self._plan += self._blend * (self._goal - self._plan)
        # No planned force on feet without floor contact.
        self._plan[~self._open] = 0.0
        feet = data.xpos[self._foot_body]
        for body, at, relief in zip(self._foot_body, feet, -self._plan, strict=True):
            mujoco.mj_applyFT(model, data, relief[:3], relief[3:], at, body, force)
        data.qfrc_applied[:] = force

    def _planned_forces(
        self, data: mujoco.MjData, wrench: Float[Array, "6"]
    ) -> Float[Array, "4 6"]:
        """Contact force and torque on each foot, world, that best reproduce a root wrench."""
        if data.ncon == 0 or not np.isfinite(wrench).all():  # divergence is detected elsewhere
            return np.zeros((len(FEET), 6))
        return contact_forces(
            np.ascontiguousarray(data.contact.pos),
            np.searchsorted(self._foot_geom, data.contact.geom.max(1)),
            self._config.friction * self._grip,
            data.xpos[self._foot_body],
            data.xpos[1],
            data.xmat[1].reshape(3, 3),
            wrench,
            self._config.torque_weight,
            self._config.regularisation,
        )


def _leg_dofs(model: mujoco.MjModel, side: str) -> Int[Array, "9"]:
    """Degrees of freedom of a leg's hip, knee and ankle."""
    first = [int(model.joint(f"{side}_{part}").dofadr[0]) for part in ("thigh", "calf", "foot")]
    return np.concatenate([np.arange(f, f + 3) for f in first])
