"""Make the reference clip of a scene and simulate its trajectory."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from egocap.errors import InputError
from egocap_sim.core.rng import make_rng
from egocap_sim.scene.config import MotionTable

if TYPE_CHECKING:
    from egocap_sim.core.pose_sampling import SampledPoses
    from egocap_sim.core.trajectory import Trajectory
    from egocap_sim.human.body.person import Person
    from egocap_sim.motion.clips.clip_check import ClipReport
    from egocap_sim.motion.clips.load import LoadedMotion
    from egocap_sim.motion.kinematics.clip import Clip
    from egocap_sim.motion.retarget.retarget import Reference

_RESAMPLING_S = 0.02  # retargeting may shorten a clip by this much
_LEAD_S = 0.5  # of an episode's motion before its first frame, for smoothing and foot contacts
_BLOCK_S = 30.0
"""Procedural motions last multiples of this, so that a longer one begins with the shorter one."""


@dataclass(frozen=True)
class MotionSource:
    """The motion of a scene: procedural or from a clip file, recorded at `fps` for `frames`."""

    table: MotionTable
    fps: float
    frames: int
    seed: int

    def clip(self) -> Clip:
        """Make or read the reference clip."""
        table = self.table
        if table.file is not None:
            return self._variant([motion.clip for motion in self._files()])
        from egocap_sim.motion.clips.editing import trim
        from egocap_sim.motion.generators.registry import make_motion

        assert table.name is not None
        needed = table.start_s + (self.frames + 1) / self.fps
        duration = table.length_s or math.ceil(needed / _BLOCK_S) * _BLOCK_S
        clip = make_motion(table.name, duration, self._rng(), **table.parameters)
        return trim(clip, self._skipped_s, duration) if self._skipped_s else clip

    def reports(self) -> list[ClipReport]:
        """What is wrong with the motion files; empty for a procedural motion."""
        return [motion.report for motion in self._files()]

    def _files(self) -> list[LoadedMotion]:
        from egocap_sim.motion.clips.clip_store import stored_motion

        table = self.table
        names = Path(table.joint_names) if table.joint_names else None
        return [
            stored_motion(Path(path), up=table.up, unit=table.unit, names=names)
            for path in (table.file, table.then) if path is not None
        ]  # fmt: skip

    def available_frames(self, clip: Clip) -> int:
        """Number of frames from the start time to the end of the clip. Raises InputError for 0."""
        start = self._start_s
        seconds = (len(clip.positions) - 1) / clip.fps - start - _RESAMPLING_S
        if seconds <= 0:
            raise InputError(
                f"start_s = {self.table.start_s:g} is beyond the end of {clip.name}",
                valid=f"less than {(seconds + start) * self.table.speed:.2f} s",
            )
        return int(seconds * self.fps) + 1

    def simulate(
        self, person: Person, margins_s: tuple[float, float] | None = None
    ) -> tuple[Trajectory, SampledPoses | None]:
        """Retarget the motion to a person and simulate it.

        Returns the trajectory at the cameras' frame times and, with `margins_s`, the poses at every
        physics step from and until so long before the first and after the last frame. The
        trajectory is bit-identical in both cases, since the frames are among these steps.
        """
        from egocap_sim.core.pose_sampling import SampledPoses
        from egocap_sim.physics.simulation import steps_per_frame

        if margins_s is None:
            return self._compared(person, self._simulate(person, 1, self.frames)), None
        steps = steps_per_frame(self.fps)
        before, after = (math.ceil(margin * self.fps) for margin in margins_s)
        samples = (self.frames - 1 + after) * steps + 1
        fine = self._simulate(person, steps, samples, before * steps)
        rows = slice(before * steps, (before + self.frames - 1) * steps + 1, steps)
        trajectory = replace(
            fine,
            fps=self.fps,
            T_world_body=fine.T_world_body[rows],
            contact=fine.contact[rows],
            ground_force=fine.ground_force[rows],
            root_wrench=fine.root_wrench[rows],
        )
        return self._compared(person, trajectory), SampledPoses.from_transforms(
            fine.T_world_body, fine.fps, -before / self.fps
        )

    def _simulate(
        self, person: Person, per_frame: int, samples: int, before: int = 0
    ) -> Trajectory:
        from egocap_sim.physics.simulation import simulate

        clip = self.clip()
        limited = self.table.file or self.table.length_s
        if limited and self.frames > (most := self.available_frames(clip)):
            raise InputError(
                f"{self.frames} frames are more than the motion has", valid=f"1 to {most}"
            )
        return simulate(
            person,
            self._reference(clip, person),
            fps=self.fps * per_frame,
            n_frames=samples,
            start_s=self._start_s,
            force_every=per_frame,
            before=before,
        )

    def _compared(self, person: Person, trajectory: Trajectory) -> Trajectory:
        """The trajectory with its distance from the motion as recorded, if that is a file's.

        The recorded motion is retargeted without cleaning, floor alignment and planted feet.
        """
        if self.table.file is None:
            return trajectory
        from egocap.body.labels import EVALUATED
        from egocap_sim.motion.retarget.retarget import retarget, sample_reference
        from egocap_sim.truth.truth import label_positions

        raw, clean = self._variant([motion.raw for motion in self._files()]), self.clip()
        positions, rotations = raw.positions.copy(), raw.rotations.copy()
        # The first pose is the origin of the motion: a repair of it would offset all frames.
        positions[0], rotations[0] = clean.positions[0], clean.rotations[0]
        raw = replace(raw, positions=positions, rotations=rotations)
        times = self._start_s + np.arange(len(trajectory.T_world_body)) / self.fps
        recorded = sample_reference(person, retarget(raw, person, grounded=False), times)
        difference = label_positions(person, trajectory.T_world_body)[:, EVALUATED, :]
        difference = difference - label_positions(person, recorded)[:, EVALUATED, :]
        error = 100 * np.linalg.norm(difference, axis=-1)
        stats = replace(
            trajectory.stats, raw_error_cm=float(error.mean()), raw_error_max_cm=float(error.max())
        )
        return replace(trajectory, stats=stats)

    def _reference(self, clip: Clip, person: Person) -> Reference:
        """Retarget the clip to the person, on the floor or on a vehicle."""
        from egocap_sim.motion.generators.registry import MOTIONS, motion_parameters
        from egocap_sim.motion.retarget.retarget import retarget

        name = self.table.name
        mounted = None if name is None else MOTIONS[name].mounted
        if name is None or mounted is None:
            return retarget(clip, person, from_origin=not self._skipped_s)
        reference = retarget(clip, person, from_origin=False, grounded=False)
        parameters = motion_parameters(name, self.table.parameters)
        return mounted(reference, person, self._rng(), parameters)

    def _variant(self, clips: list[Clip]) -> Clip:
        """Cut, join, mirror and change the speed of the clips according to the table."""
        from egocap_sim.motion.clips.editing import change_speed, join_clips, mirror, trim

        table, clip = self.table, clips[0]
        if table.then is not None:
            assert table.length_s is not None
            half = 0.5 * table.length_s * table.speed
            following = trim(clips[1], table.then_start_s, half)
            clip = join_clips(trim(clip, table.start_s, half), following)
        elif table.length_s is not None:
            clip = trim(clip, table.start_s, table.length_s * table.speed)
        if table.mirrored:
            clip = mirror(clip)
        return change_speed(clip, table.speed) if table.speed != 1.0 else clip

    @property
    def _start_s(self) -> float:
        """Time in `clip` of the first frame, seconds as played."""
        if self.table.file is None:
            return self.table.start_s - self._skipped_s
        return 0.0 if self.table.length_s is not None else self.table.start_s / self.table.speed

    @property
    def _skipped_s(self) -> float:
        """Duration at the start of an episode's procedural motion that is not simulated."""
        from egocap_sim.motion.generators.registry import MOTIONS

        name = self.table.name
        if name is None or self.table.length_s is None or MOTIONS[name].mounted:
            return 0.0
        return max(0.0, self.table.start_s - _LEAD_S)

    def _rng(self) -> np.random.Generator:
        return make_rng(self.seed, "motion")
