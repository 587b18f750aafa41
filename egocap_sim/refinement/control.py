"""Tracking control with forces at supports, and a penalised residual wrench.

The accelerations that computed torque wants need a wrench at the free head. Forces at the supports
supply it as far as they can (non-negative least squares over the edges of friction pyramids). The
rest is shared, by weights, between a change of the accelerations and a residual wrench:
min |change|^2_W + |residual|^2_L,  residual = rest + M change, in closed form.

Source: a penalised residual at the root: Shimada et al. 2020, "PhysCap: physically plausible
monocular 3D motion capture in real time", section 3.4; feedback as in `egocap_sim.physics.control`.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.data.track import CONTACTS
from egocap.geometry import GRAVITY
from egocap_sim.physics.contact_forces import nonnegative_least_squares
from egocap_sim.refinement.humanoid import SITE_SUPPORT, SUPPORTS

_FEET = np.isin(SITE_SUPPORT, np.arange(len(CONTACTS)))  # sites


@dataclass(frozen=True)
class ControlConfig:
    """What the body follows, gain of the feedback, and weights of the forces."""

    cutoff_hz: float = 6.0  # of the low-pass filter through which the track passes first
    rate: float = 20.0  # rad/s: natural frequency of the critically damped feedback
    residual: float = 0.3  # standard deviation of the residual force, body weights; torque: x 1 m
    head_shift: float = 3.0  # standard deviation of the change of the head's acceleration, m/s^2
    head_turn: float = 10.0  # the same of its turning, rad/s^2
    angle: float = 20.0  # the same of the angles, rad/s^2
    slip: float = 0.3  # the same of points of the feet that stand, m/s^2
    friction: float = 0.8  # slope of the friction pyramids
    regularisation: float = 0.03  # of forces in body weights: spreads them over the supports
    least: float = 0.02  # supports that are less probable bear nothing


@dataclass(frozen=True, eq=False)
class Forces:
    """Forces of one step."""

    torque: Float[Array, "43"]  # generalised, of all that moves the body
    support: Float[Array, "10 3"]  # on `SUPPORTS`, N, world
    residual: Float[Array, "6"]  # N, world, and N m about the head in its axes: of nothing


class Controller:
    """Control of one humanoid."""

    def __init__(self, model: mujoco.MjModel, config: ControlConfig) -> None:
        self.model, self._config = model, config
        self.weight = model.body_subtreemass[1] * float(np.linalg.norm(GRAVITY))  # N
        sigma = np.full(model.nv, config.angle)
        sigma[:3], sigma[3:6] = config.head_shift, config.head_turn
        self._stiff = np.diag(1.0 / sigma**2)
        self._free = np.diag(np.full(6, (config.residual * self.weight) ** 2))
        s = config.friction
        self._edges = np.array([(s, 0.0, 1.0), (-s, 0.0, 1.0), (0.0, s, 1.0), (0.0, -s, 1.0)])
        self._sites = [model.site(str(i)).id for i in range(len(SITE_SUPPORT))]
        self._error, self._inertia = np.zeros(model.nv), np.zeros((model.nv, model.nv))

    def forces(
        self, data: mujoco.MjData, qpos: Float[Array, "44"], qvel: Float[Array, "43"],
        qacc: Float[Array, "43"], probable: Float[Array, "10"],
    ) -> Forces:  # fmt: skip
        """Forces of a step towards a state; positions and velocities must be up to date.

        `probable` are the probabilities that `SUPPORTS` bear.
        """
        model, dt, rate = self.model, self.model.opt.timestep, self._config.rate
        mujoco.mj_differentiatePos(model, self._error, 1.0, data.qpos, qpos)
        lag = qvel - data.qvel
        # Feedback evaluated one step ahead, so that any gain is stable.
        feedback = rate**2 * (self._error + dt * lag) + 2 * rate * lag
        wanted = qacc + feedback / (1 + 2 * rate * dt + (rate * dt) ** 2)
        mujoco.mj_fullM(model, data, self._inertia)
        head = self._inertia[:6]
        sites = np.flatnonzero(probable[SITE_SUPPORT] >= self._config.least)
        J, likely = self._jacobians(data, sites), probable[SITE_SUPPORT[sites]]
        standing = likely * _FEET[sites] / self._config.slip**2
        stiff = self._stiff + np.einsum("n,nia,nib->ab", standing, J, J, optimize=True)
        yielding = np.linalg.solve(stiff, head.T)
        share = np.linalg.inv(self._free + head @ yielding)
        wrench = head @ wanted + data.qfrc_bias[:6]
        pushes = self._pushes(J[..., :6], likely, wrench)
        rest = wrench - np.einsum("ni,nid->d", pushes, J[..., :6])
        change = -yielding @ (share @ rest)
        support = np.zeros((len(SUPPORTS), 3))
        np.add.at(support, SITE_SUPPORT[sites], pushes)
        return Forces(
            self._inertia @ (wanted + change) + data.qfrc_bias, support, rest + head @ change
        )

    def _jacobians(self, data: mujoco.MjData, sites: Int[Array, "N"]) -> Float[Array, "N 3 43"]:
        """Derivatives of the sites' positions."""
        J = np.zeros((len(sites), 3, self.model.nv))
        for row, site in zip(J, sites, strict=True):
            mujoco.mj_jacSite(self.model, data, row, None, self._sites[site])
        return J

    def _pushes(
        self, J: Float[Array, "N 3 6"], likely: Float[Array, "N"], wrench: Float[Array, "6"]
    ) -> Float[Array, "N 3"]:
        """Forces at the sites, N: the less probable a support, the less it bears."""
        columns = np.einsum("ei,nid->dne", self._edges, J).reshape(6, -1)
        reluctant = np.repeat(likely, len(self._edges))
        pulls = nonnegative_least_squares(
            columns * reluctant, wrench / self.weight, self._config.regularisation
        )
        return self.weight * (reluctant * pulls).reshape(-1, len(self._edges)) @ self._edges
