"""Torques that make the simulated person follow a motion.

Computed torque: M (qacc + feedback) + bias gives the generalised forces the motion needs. The six of
them at the free root nobody can apply; they are first explained by pushes of the floor against the
feet (non-negative least squares over the edges of the friction pyramids at the contact points). The
planned pushes are taken off the joint torques too, since the floor will deliver them. What they do
not explain stays as a residual wrench on the root.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import nnls

from egocap_sim.bodies import FEET, INDEX
from egocap_sim.physics.target import Target


@dataclass(frozen=True)
class ControlConfig:
    """Gains of the tracking controller."""

    joint_rate: float = 30.0  # rad/s: natural frequency of the critically damped joint feedback
    root_rate: float = 20.0  # rad/s: the same for the root
    friction: float = 0.6  # slope of the planned friction pyramid, below the floor's own
    torque_weight: float = 4.0  # weight of the root's torques against its forces, 1/m
    regularisation: float = 0.02  # of planned pushes: spreads them over the contact points
    plan_filter_s: float = 0.02  # time constant of the planned pushes


class Controller:
    """Tracking controller of one model; holds the filtered plan between steps."""

    def __init__(self, model: mujoco.MjModel, config: ControlConfig) -> None:
        self._model, self._config = model, config
        dt, nv = model.opt.timestep, model.nv
        rate = np.full(nv, config.joint_rate)
        rate[:6] = config.root_rate
        # Feedback evaluated one step ahead (stable PD, Tan et al. 2011), so any gain is stable.
        self._damping = 2 * rate / (1 + 2 * rate * dt + (rate * dt) ** 2)
        self._stiffness = rate**2 / (1 + 2 * rate * dt + (rate * dt) ** 2)
        self._blend = min(1.0, dt / config.plan_filter_s)
        self._foot_body = [INDEX[foot] + 1 for foot in FEET]
        self._foot_geom = np.array([model.geom(foot).id for foot in FEET])
        self._plan = np.zeros(nv)
        self._error, self._inertia = np.zeros(nv), np.zeros(nv)
        self._jacobian, self._spin = np.zeros((3, nv)), np.zeros((3, nv))
        k = config.friction
        self._edges = np.array([(k, 0, 1), (-k, 0, 1), (0, k, 1), (0, -k, 1)], float)

    def gate(self, planted: Bool[Array, "4"]) -> None:
        """Let only the feet that the motion plants collide with the floor."""
        self._model.geom_conaffinity[self._foot_geom] = planted

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
        self._plan += self._blend * (self._planned(data, force[:6]) - self._plan)
        data.qfrc_applied[:] = force - self._plan

    def _planned(self, data: mujoco.MjData, wrench: Float[Array, "6"]) -> Float[Array, "nv"]:
        """Generalised forces of the floor's best pushes against the feet for a root wrench."""
        if data.ncon == 0:
            return np.zeros(self._model.nv)
        points, geoms = data.contact.pos, data.contact.geom.max(1)
        config, weight = self._config, np.ones(6)
        weight[3:] = config.torque_weight
        n, edges = len(points), self._edges
        # The free joint's torques are in the pelvis frame, its forces in the world's.
        R = data.xmat[1].reshape(3, 3)
        arms = np.cross((points - data.xpos[1])[:, None], edges[None]) @ R
        columns = np.concatenate([np.broadcast_to(edges, (n, 4, 3)), arms], -1).reshape(-1, 6)
        A = np.concatenate([columns.T * weight[:, None], config.regularisation * np.eye(4 * n)])
        pushes, _ = nnls(A, np.concatenate([wrench * weight, np.zeros(4 * n)]), maxiter=40 * n)
        forces = pushes.reshape(n, 4) @ edges
        plan = np.zeros(self._model.nv)
        for geom in set(geoms.tolist()):
            mine = geoms == geom
            body = self._model.geom_bodyid[geom]
            mujoco.mj_jac(self._model, data, self._jacobian, self._spin, data.xpos[body], body)
            moment = np.cross(points[mine] - data.xpos[body], forces[mine]).sum(0)
            plan += forces[mine].sum(0) @ self._jacobian + moment @ self._spin
        return plan
