"""Step a person through a reference motion under forward dynamics."""

from __future__ import annotations

import math
import time

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import rigid
from egocap_sim.core.bodies import BODIES, FEET
from egocap_sim.core.trajectory import Trajectory
from egocap_sim.human.body.person import Person
from egocap_sim.motion.retarget.retarget import Reference
from egocap_sim.physics.control import ControlConfig, Controller
from egocap_sim.physics.model import build_model
from egocap_sim.physics.reference import BLOCK, Target, TargetMotion
from egocap_sim.physics.tracking_stats import TrackingMonitor

STEPS_PER_S = 250.0  # at least; a whole number of steps fits between two camera frames
_LEAD_S = 0.7  # simulated before the first frame: the feet settle, and exposures may be early
_TOUCH_N = 1.0  # newtons: the least force that counts as contact
_FASTEST = 25.0  # metres a second: twice a sprinter
_LOST_M = 1.0  # pelvis error that aborts the simulation


def simulate(
    person: Person,
    reference: Reference,
    fps: float = 30.0,
    n_frames: int | None = None,
    start_s: float = 0.0,
    control: ControlConfig | None = None,
    force_every: int = 1,
    before: int = 0,
) -> Trajectory:
    """Simulate the person following the reference; frame k is the state at k / fps seconds.

    It begins at `start_s` seconds of the reference and by default runs to its end; beyond that the
    person holds the last pose. The steps before the first frame follow the reference too, or hold
    its first pose, so that the forces are settled in the first frame. The result is deterministic
    except `stats.ms_per_second`. Contacts and forces are recorded in every
    `force_every`-th frame and zero in the others. The result begins with `before` frames of the
    steps before the first.

    Raises InputError for invalid arguments and for a motion that the person cannot follow.
    """
    n_frames = _check(reference, fps, n_frames, start_s)
    substeps = steps_per_frame(fps)
    model = build_model(person, 1.0 / (fps * substeps), reference.ground_boxes)
    timestep = model.opt.timestep
    run = _Run(model, Controller(model, control or ControlConfig()), before + n_frames)
    monitor = TrackingMonitor(person, model, reference.ground_boxes)
    motion = TargetMotion(reference)
    steps = (n_frames - 1) * substeps + 1
    lead = max(math.ceil(_LEAD_S / timestep), before * substeps)
    moves = max(-lead, math.ceil(-start_s / timestep))  # the first step that does not hold a pose
    started = time.process_time()
    for first in range(-lead, steps, BLOCK):
        target = motion.block(first, min(BLOCK, steps - first), timestep, start_s)
        for i in range(len(target.qpos)):
            step = first + i
            if step == -lead:
                run.data.qpos[:] = target.qpos[i]
            if step == moves:
                run.data.qvel[:] = target.qvel[i]
            sound = run.step(target, i)
            frame, within = divmod(step, substeps)
            if within == 0 and frame >= -before:
                run.record(before + frame, forces=frame % force_every == 0)
            if step >= 0:
                monitor.observe(run.data, target, i)
            if not (sound and monitor.lost_m < _LOST_M):
                raise InputError(
                    f"the person cannot follow the motion: diverged after "
                    f"{max(step, 0) * timestep:.2f} s",
                    valid="a motion without jumps between its frames",
                )
    seconds = time.process_time() - started
    stats = monitor.stats(ms_per_second=1e3 * seconds / ((lead + steps) * timestep))
    return Trajectory(fps, run.T_world_body, run.contact, run.ground_force, run.root_wrench, stats)


def steps_per_frame(fps: float) -> int:
    """Physics steps between two frames at a frame rate."""
    return int(np.ceil(STEPS_PER_S / fps - 1e-9))


def _check(reference: Reference, fps: float, n_frames: int | None, start_s: float) -> int:
    """Raise InputError for invalid arguments; return the number of frames to simulate."""
    if not 1.0 <= fps <= 1000.0:
        raise InputError(f"cannot simulate {fps:g} frames per second", valid="1 to 1000")
    if not 0.0 <= start_s < reference.duration_s:
        raise InputError(
            f"cannot start at {start_s:g} s", valid=f"0 to {reference.duration_s:.2f} s"
        )
    if not (np.isfinite(reference.root).all() and np.isfinite(reference.rotations).all()):
        raise InputError("the reference motion has values that are not finite numbers")
    speed = np.linalg.norm(np.diff(reference.root, axis=0), axis=1) * reference.fps
    if speed.max(initial=0.0) > _FASTEST:
        raise InputError(
            f"the motion jumps at {speed.argmax() / reference.fps:.2f} s: {speed.max():.0f} m/s",
            valid=f"up to {_FASTEST:g} m/s",
        )
    if n_frames is None:
        n_frames = int((reference.duration_s - start_s) * fps + 1e-6) + 1
    if n_frames < 1:
        raise InputError(f"cannot simulate {n_frames} frames", valid="1 or more")
    return n_frames


class _Run:
    """State and recorded data of one simulation."""

    def __init__(self, model: mujoco.MjModel, controller: Controller, n_frames: int) -> None:
        self._model, self._controller = model, controller
        self.data = mujoco.MjData(model)
        self._positions = np.zeros((n_frames, len(BODIES), 3))
        self._rotations = np.zeros((n_frames, len(BODIES), 3, 3))
        self.contact = np.zeros((n_frames, len(FEET)), bool)
        self.ground_force = np.zeros((n_frames, 2, 3))
        self.root_wrench = np.zeros((n_frames, 6))
        self._foot_geoms = [model.geom(foot).id for foot in FEET]

    def step(self, target: Target, i: int) -> bool:
        """Advance one step; afterwards positions and forces in `data` are those at its start.

        Returns False, without the step, if the forces are not finite.
        """
        self._controller.gate(target.planted[i], target.touching[i])
        mujoco.mj_step1(self._model, self.data)
        self._controller.apply(self.data, target, i)
        if not np.isfinite(self.data.qfrc_applied).all():
            return False
        mujoco.mj_step2(self._model, self.data)
        return True

    def record(self, frame: int, forces: bool) -> None:
        """Record the body poses of a frame and, with `forces`, the forces on them."""
        data = self.data
        self._positions[frame] = data.xpos[1:]
        self._rotations[frame] = data.xmat[1:].reshape(-1, 3, 3)
        if not forces:
            return
        self.root_wrench[frame, :3] = data.qfrc_applied[:3]
        self.root_wrench[frame, 3:] = self._rotations[frame, 0] @ data.qfrc_applied[3:6]
        wrenches = np.zeros((data.ncon, 6))
        for k, wrench in enumerate(wrenches):
            mujoco.mj_contactForce(self._model, data, k, wrench)
        geoms = data.contact.geom
        foot = np.searchsorted(self._foot_geoms, geoms.max(1))
        self.contact[frame, foot[wrenches[:, 0] > _TOUCH_N]] = True
        # The normal, first row of the contact's frame, points from the first geom to the other.
        contact_forces = np.einsum(
            "ki,kij->kj", wrenches[:, :3], data.contact.frame.reshape(-1, 3, 3)
        )
        contact_forces[geoms[:, 0] > geoms[:, 1]] *= -1.0
        np.add.at(self.ground_force[frame], foot // 2, contact_forces)

    @property
    def T_world_body(self) -> Float[Array, "T 21 4 4"]:
        """Poses of the bodies in the frames recorded."""
        return rigid(self._rotations, self._positions)
