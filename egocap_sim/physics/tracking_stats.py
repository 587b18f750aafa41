"""Accuracy of a simulation against its reference, and quality of its contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from egocap.body.labels import EVALUATED, LABELS
from egocap.geometry import GRAVITY
from egocap_sim.core.bodies import FEET, INDEX, LABEL_BODY
from egocap_sim.core.ground_boxes import GroundBox, ground_height
from egocap_sim.core.trajectory import PhysicsStats
from egocap_sim.human.body.person import Person
from egocap_sim.human.body.soles import soles
from egocap_sim.physics.reference import Target

_EVERY_S = 0.02  # how often the motion is sampled, seconds
_PLANTED_HEIGHT = 0.02  # metres: a sole point of the reference lower and
_PLANTED_SPEED = 0.2  # slower (m/s) than this is planted


class TrackingMonitor:
    """Compare the simulated person with the reference at the same instant.

    Errors are distances of the 17 evaluated joints. A sole point is planted if it is low and slow
    in the *reference*; its speed and depth are the simulated ones.
    """

    def __init__(
        self, person: Person, model: mujoco.MjModel, ground_boxes: Sequence[GroundBox] = ()
    ) -> None:
        self._ground_boxes = ground_boxes
        self._model, self._reference = model, mujoco.MjData(model)
        self._every = max(1, round(_EVERY_S / model.opt.timestep))
        self._interval = self._every * model.opt.timestep
        self._weight = model.body_subtreemass[1] * float(np.linalg.norm(GRAVITY))
        labels = [LABELS[i] for i in EVALUATED]
        self._bodies = np.array(
            [1 + INDEX[LABEL_BODY[name]] for name in labels]
            + [1 + INDEX[foot] for foot in FEET for _ in range(4)]
        )
        self._offsets = np.concatenate(
            [np.array([person.landmarks[name] for name in labels])]
            + [sole.corners for sole in soles(person)]
        )
        self._joints = len(labels)
        self._simulated: list[np.ndarray] = []
        self._wanted: list[np.ndarray] = []
        self._residual: list[np.ndarray] = []
        self._steps = 0
        self.lost_m = 0.0
        """Distance of the pelvis from the reference at the last step; NaN after divergence."""

    def observe(self, data: mujoco.MjData, target: Target, i: int) -> None:
        """Record the state at the start of the step just taken."""
        self.lost_m = math.dist(data.xpos[1], target.qpos[i, :3])
        self._residual.append(data.qfrc_applied[:3].copy())
        if self._steps % self._every == 0:
            self._reference.qpos[:] = target.qpos[i]
            mujoco.mj_kinematics(self._model, self._reference)
            self._simulated.append(self._points(data))
            self._wanted.append(self._points(self._reference))
        self._steps += 1

    def stats(self, ms_per_second: float) -> PhysicsStats:
        """Statistics of everything recorded so far."""
        simulated, wanted = np.stack(self._simulated), np.stack(self._wanted)
        j = self._joints
        error = 100 * np.linalg.norm(simulated[:, :j] - wanted[:, :j], axis=-1)
        for points in (simulated, wanted):  # heights over the ground below
            points[:, j:, 2] -= ground_height(self._ground_boxes, points[:, j:, :2])
        residual = np.linalg.norm(self._residual, axis=1)
        depth = 100 * np.maximum(0.0, -simulated[:, j:, 2].min(1))
        return PhysicsStats(
            joint_error_cm=float(error.mean()),
            joint_error_p95_cm=float(np.percentile(error, 95)),
            joint_error_max_cm=float(error.max()),
            planted_foot_speed_cm_s=100 * self._planted_speed(simulated[:, j:], wanted[:, j:]),
            penetration_cm=float(np.median(depth)),
            penetration_max_cm=float(depth.max()),
            residual_wrench_bw=float(np.median(residual) / self._weight),
            ms_per_second=ms_per_second,
        )

    def _planted_speed(self, simulated: np.ndarray, wanted: np.ndarray) -> float:
        """Median horizontal speed (m/s) of planted sole points; 0 if there are none."""
        if len(wanted) < 2:
            return 0.0
        low = wanted[..., 2] < _PLANTED_HEIGHT
        slow = np.linalg.norm(np.diff(wanted, axis=0), axis=-1) < _PLANTED_SPEED * self._interval
        planted = low[1:] & low[:-1] & slow
        speed = np.linalg.norm(np.diff(simulated[..., :2], axis=0), axis=-1) / self._interval
        return float(np.median(speed[planted])) if planted.any() else 0.0

    def _points(self, data: mujoco.MjData) -> np.ndarray:
        """World positions of the evaluated joints and the sole corners."""
        rotations = data.xmat.reshape(-1, 3, 3)[self._bodies]
        return data.xpos[self._bodies] + np.einsum("nij,nj->ni", rotations, self._offsets)
