"""Follow a tracked motion with a simulated body on forces at its supports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.ndimage import median_filter

from egocap.body.gaussians import stature
from egocap.body.kinematics import label_positions
from egocap.body.labels import LABEL_INDEX
from egocap.body.proportions import Proportions
from egocap.data.track import CONTACTS, Track
from egocap.errors import InputError
from egocap.geometry import GRAVITY, quaternion_to_matrix, rigid, transform
from egocap.series import runs
from egocap_sim.refinement.control import ControlConfig, Controller
from egocap_sim.refinement.humanoid import HINGES, SUPPORTS, build_humanoid
from egocap_sim.refinement.reference import Reference

STEPS_PER_S = 250.0  # at least
BODY_MASS_INDEX = 23.0
"""kg/m^2, of a wearer whose mass is not given."""
_SHORTEST_S, _LONGEST_STEP_S = 0.5, 0.2  # of a stretch, and between its frames
_FASTEST = 15.0  # m/s: a head that is faster has jumped
_LOST_M = 0.5  # distance of the head from the track that ends the simulation
_AT_REST = {"hip": 0.3, "knee": 0.03, "hand": 0.03}
"""Probability that a resting seat, knee or hand bears weight, as the tracker does not state it."""
_RESTS = 0.1  # speed at which that is half as probable, m/s
_MISSING, _SUSTAINED_S = 0.5, 0.25
"""Residual force, in body weights, that is missing for half of such a time where nothing known
bears the body, as on a bicycle or where a contact is lost; in a flight none is missing."""
_RIGID = dict.fromkeys(("head_shift", "head_turn", "angle"), 1e-6)  # no change: as tracked


@dataclass(frozen=True, eq=False)
class Refinement:
    """A track that a simulated body has followed, and the forces on the body."""

    track: Track
    refined: Bool[Array, "T"]  # frames in the world, in stretches long enough; the others are kept
    support: Float[Array, "T 10 3"]  # forces on `SUPPORTS`, N, world
    residual: Float[Array, "T 6"]  # force, N, world, and torque about the head, N m, of nothing
    residual_before: Float[Array, "T 6"]  # the same for the motion as tracked
    moved: Float[Array, "T 18"]  # distance of the joints in the world from the tracked ones, m
    mass_kg: float

    @property
    def weight(self) -> float:
        """Of the body, N."""
        return self.mass_kg * float(np.linalg.norm(GRAVITY))


def refine(
    track: Track, mass_kg: float | None = None, config: ControlConfig | None = None,
    on_frames: Callable[[int], None] = lambda frames: None,
) -> Refinement:  # fmt: skip
    """The motion of a simulated body that follows a track in the world.

    `mass_kg`: of the wearer; by default of an average one with the track's bones. `on_frames` is
    called with numbers of frames, of which each is simulated twice: as tracked, and refined. Raises
    InputError for a track without contacts, too short, or that the body cannot follow.
    """
    if track.contacts is None or track.T_world_head is None or track.joints_world is None:
        raise InputError("the track has no contacts", valid="a track made with --head-pose")
    if track.offsets is None:
        raise InputError("the track has no bones", valid="a track of `egocap track`")
    stretches = [*_stretches(track)]
    on_frames(2 * (len(track.times) - sum(map(len, stretches))))
    if not stretches:
        raise InputError(f"the track has no stretch of {_SHORTEST_S:g} s with known head poses")
    proportions = Proportions(track.offsets)
    mass = BODY_MASS_INDEX * stature(proportions) ** 2 if mass_kg is None else mass_kg
    model, config = build_humanoid(proportions, mass), config or ControlConfig()
    probable = _probabilities(track)
    refined = np.zeros(len(track.times), bool)
    heads, angles = track.T_world_head.copy(), track.angles.copy()
    support = np.zeros((len(track.times), len(SUPPORTS), 3))
    residual, before = np.zeros((2, len(track.times), 6))
    free, penalised = Controller(model, replace(config, **_RIGID)), Controller(model, config)
    for stretch in stretches:
        motion = Reference.of(track, stretch, config.cutoff_hz)
        _, support[stretch], before[stretch] = _follow(
            free, motion, track.times[stretch], probable[stretch], on_frames
        )
        residual[stretch] = before[stretch]
        for frames in _borne(stretch, track.times, before / free.weight):
            poses, support[frames], residual[frames] = _follow(
                penalised, motion, track.times[frames], probable[frames], on_frames
            )
            heads[frames] = rigid(quaternion_to_matrix(poses[:, 3:7]), poses[:, :3])
            angles[np.ix_(frames, HINGES)] = poses[:, 7:]
            refined[frames] = True
        on_frames(int(np.sum(~refined[stretch])))
    joints = label_positions(proportions, angles)
    world = transform(heads, joints)
    found = replace(
        track, angles=angles, joints_head=joints, T_world_head=heads, joints_world=world,
        config={**track.config, "refined": {**vars(config), "mass_kg": round(mass, 1)}},
    )  # fmt: skip
    moved = np.linalg.norm(world - track.joints_world, axis=-1)
    return Refinement(found, refined, support, residual, before, moved, mass)


def _stretches(track: Track) -> Iterator[Int[Array, "n"]]:
    """Frames of each stretch with known head poses, without long steps and jumps."""
    assert track.T_world_head is not None
    way = np.linalg.norm(np.diff(track.T_world_head[:, :3, 3], axis=0), axis=1)
    steps = np.diff(track.times)
    ends = np.append((steps > _LONGEST_STEP_S) | (way > _FASTEST * steps), True)
    known = np.ones(len(track.times), bool) if track.in_world is None else track.in_world
    for run in runs(np.flatnonzero(known)):
        for part in np.split(run, np.flatnonzero(ends[run[:-1]]) + 1):
            if np.ptp(track.times[part]) >= _SHORTEST_S:
                yield part


def _borne(
    stretch: Int[Array, "n"], times: Float[Array, "T"], residual: Float[Array, "T 6"]
) -> Iterator[Int[Array, "m"]]:
    """Parts of a stretch whose forces the supports explain; the residual is in body weights."""
    window = max(1, round(_SUSTAINED_S / float(np.median(np.diff(times[stretch])))))
    force = np.linalg.norm(residual[stretch, :3], axis=1)
    missing = median_filter(force, window, mode="nearest") > _MISSING
    for part in runs(stretch[~missing]):
        if np.ptp(times[part]) >= _SHORTEST_S:
            yield part


def _probabilities(track: Track) -> Float[Array, "T 10"]:
    """Probability that each of `SUPPORTS` bears: the track's, and that of parts which rest."""
    assert track.contacts is not None and track.joints_world is not None
    found = np.zeros((len(track.times), len(SUPPORTS)))
    found[:, : len(CONTACTS)] = track.contacts
    for k, name in enumerate(SUPPORTS[len(CONTACTS) :], len(CONTACTS)):
        path = track.joints_world[:, LABEL_INDEX[name]]
        speed = np.linalg.norm(np.gradient(path, track.times, axis=0), axis=-1)
        found[:, k] = _AT_REST[name.partition("_")[2]] / (1.0 + np.square(speed / _RESTS))
    return found


def _follow(
    controller: Controller, motion: Reference, times: Float[Array, "T"],
    probable: Float[Array, "T 10"], on_frames: Callable[[int], None],
) -> tuple[Float[Array, "T 44"], Float[Array, "T 10 3"], Float[Array, "T 6"]]:  # fmt: skip
    """Simulate a stretch: poses, forces on the supports and residual wrench in each frame."""
    model = controller.model
    data = mujoco.MjData(model)
    wanted = motion.positions(times)
    data.qpos[:], data.qvel[:] = wanted[0], motion.velocities(times[:1])[0]
    poses, support, residual = (np.empty((len(times), *n)) for n in ((44,), (10, 3), (6,)))
    for t, start in enumerate(times):
        way = times[t + 1] - start if t + 1 < len(times) else 1.0 / STEPS_PER_S
        steps = ceil(way * STEPS_PER_S - 1e-9)
        dt = model.opt.timestep = way / steps
        at = start + dt * np.arange(steps)
        qpos, qvel, qacc = (
            motion.positions(at), motion.velocities(at - dt / 2), motion.accelerations(at)
        )  # fmt: skip
        poses[t] = data.qpos
        if not np.linalg.norm(data.qpos[:3] - wanted[t, :3]) < _LOST_M:
            raise InputError(f"the body cannot follow the track: lost at {start:.2f} s",
                             valid="a larger residual")  # fmt: skip
        for i in range(steps):
            mujoco.mj_step1(model, data)
            forces = controller.forces(data, qpos[i], qvel[i], qacc[i], probable[t])
            if i == 0:
                support[t], residual[t] = forces.support, forces.residual
            data.qfrc_applied[:] = forces.torque
            mujoco.mj_step2(model, data)
        on_frames(1)
    return poses, support, residual
