"""Sensor plan of a recording: the faults of each frame and the matching ground truth.

It is made once before rendering and passed to the workers through the sequence's folder.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Rig
from egocap.data.truth import OUT_OF_VIEW, VISIBLE, SensorTruth, Truth
from egocap.geometry import inverse
from egocap_sim.core.bodies import INDEX, LABEL_BODY
from egocap_sim.core.pose_sampling import SampledPoses
from egocap_sim.core.rng import make_rng
from egocap_sim.human.body.person import Person
from egocap_sim.sensor.config import SensorTable
from egocap_sim.sensor.faults import draw_sources, exposure_drift
from egocap_sim.sensor.light import lamp_phase, lamp_rows
from egocap_sim.sensor.timing import overlap_in_time, row_time

DRAFTS = _TRUTH, _MOTION, _RATE = "sensor.draft.tmp", "motion.draft.tmp", "rate.draft.tmp"
"""Temporary files in a sequence's folder that workers read; removed when it is complete."""
_ROUNDS = 4  # fixed-point iterations for the row and exposure time of a joint
_BLOCK = 500  # frames processed together: bounds memory
_FAR_M = 1.5  # assumed distance of the surroundings
_BODIES = np.array([INDEX[LABEL_BODY[label]] for label in LABELS])


@dataclass(frozen=True, eq=False)
class SensorPlan:
    """A sensor, its random seed, its faults of each frame, and the bodies between frames."""

    sensor: SensorTable
    seed: int
    applied: SensorTruth
    poses: SampledPoses | None  # None if every image shows the instant of its frame

    def save(self, folder: Path) -> None:
        """Write it to a sequence's folder for the workers, under temporary names."""
        self.applied.save(folder / _TRUTH)
        if self.poses is not None:
            self.poses.save(folder / _MOTION)
            (folder / _RATE).write_text(f"{self.poses.rate!r} {self.poses.start_s!r}")

    @classmethod
    def load(cls, folder: Path, sensor: SensorTable, seed: int) -> SensorPlan:
        """Read the files of `save`."""
        poses = None
        if sensor.timed:
            rate, start_s = map(float, (folder / _RATE).read_text().split())
            poses = SampledPoses.load(folder / _MOTION, rate, start_s)
        return cls(sensor, seed, SensorTruth.load(folder / _TRUTH), poses)


def plan_sensor(
    truth: Truth,
    person: Person,
    poses: SampledPoses | None,
    rig: Rig,
    sensor: SensorTable,
    seed: int,
) -> tuple[SensorPlan, Truth]:
    """Draw the faults of each frame; also returns the truth at the times of exposure."""
    frames, views = len(truth.time), len(rig.views)
    middle = np.repeat(truth.time[:, None], views, 1)
    middle[:, 1:] *= 1.0 + 1e-6 * sensor.clock_drift_ppm
    middle[:, 1:] += sensor.time_offset_s
    streams = [make_rng(seed, f"sensor.exposure.{v}") for v in rig.views]
    drift = [exposure_drift(truth.time, sensor.exposure_drift_ev, rng) for rng in streams]
    shown = [draw_sources(frames, sensor.drop_rate, sensor.drop, make_rng(seed, f"sensor.drop.{v}"))
             for v in rig.views]  # fmt: skip
    joint_time = np.repeat(middle[..., None], len(LABELS), -1)
    subframes = np.ones(frames, int)
    if poses is not None:
        for first in range(0, frames, _BLOCK):
            block = slice(first, first + _BLOCK)
            joint_time[block] = _joint_times(poses, person, rig, sensor, middle[block])
            subframes[block] = _subframes(poses, person, rig, sensor, middle[block])
        truth = _expose_truth(truth, poses, person, rig, joint_time)
    applied = SensorTruth(
        time=middle,
        joint_time=joint_time,
        exposure_ev=sensor.exposure_ev
        + np.stack(drift, 1)
        + _flicker_ev(rig, sensor, seed, middle),
        source=np.stack(shown, 1),
        subframes=subframes,
    )
    return SensorPlan(sensor, seed, applied, poses), truth


def _flicker_ev(
    rig: Rig, sensor: SensorTable, seed: int, middle: Float[Array, "T V"]
) -> Float[Array, "T V"]:
    """Exposure offset of each image by lamp flicker, in stops: the mean over its rows."""
    if not sensor.flicker:
        return np.zeros_like(middle)
    phase = lamp_phase(make_rng(seed, "sensor.flicker"))
    heights = [camera.height for camera in rig.cameras]
    light = [[lamp_rows(t, h, sensor, phase).mean() for t, h in zip(row, heights, strict=True)]
             for row in middle]  # fmt: skip
    return np.log2(np.maximum(light, 1e-3))


def _joints(
    poses: SampledPoses, person: Person, times: Float[Array, "*n 18"]
) -> tuple[Float[Array, "*n 18 3"], Float[Array, "*n 18 3"]]:
    """Joints in the world, and in the head frame of the same instant, each at its own time."""
    offsets = np.stack([person.landmarks[label] for label in LABELS])
    T_world_body = poses.at_bodies(times, _BODIES)
    T_head_world = inverse(poses.at_bodies(times, np.array(INDEX["head"])))
    world = (T_world_body[..., :3, :3] @ offsets[:, :, None])[..., 0] + T_world_body[..., :3, 3]
    head = (T_head_world[..., :3, :3] @ world[..., None])[..., 0] + T_head_world[..., :3, 3]
    return world, head


def _joint_times(
    poses: SampledPoses, person: Person, rig: Rig, sensor: SensorTable, middle: Float[Array, "t V"]
) -> Float[Array, "t V 18"]:
    """Time at which each view exposes each joint, by the row of its projection."""
    times = np.repeat(middle[..., None], len(LABELS), -1)
    if not sensor.readout_s:
        return times
    for _ in range(_ROUNDS):
        for v, mount in enumerate(rig.mounts):
            joints = _joints(poses, person, times[:, v])[1]
            pixels, _ = mount.camera.project(_in_camera(mount.T_head_camera, joints))
            height = mount.camera.height
            rows = np.clip(pixels[..., 1], -0.5, height - 0.5)
            times[:, v] = row_time(middle[:, v, None], rows, height, sensor.readout_s)
    return times


def _expose_truth(
    truth: Truth, poses: SampledPoses, person: Person, rig: Rig, times: Float[Array, "T V 18"]
) -> Truth:
    """The truth with camera joints and projections at the times of exposure."""
    joints_camera = np.empty_like(truth.joints_camera)
    joints_2d, in_view = np.empty_like(truth.joints_2d), np.empty_like(truth.in_view)
    for first in range(0, len(times), _BLOCK):
        block = slice(first, first + _BLOCK)
        for v, mount in enumerate(rig.mounts):
            joints = _joints(poses, person, times[block, v])[1]
            joints_camera[block, v] = _in_camera(mount.T_head_camera, joints)
            joints_2d[block, v], in_view[block, v] = mount.camera.project(joints_camera[block, v])
    return replace(
        truth,
        joints_camera=joints_camera,
        joints_2d=joints_2d,
        in_view=in_view,
        visibility=np.where(in_view, VISIBLE, OUT_OF_VIEW).astype(np.uint8),
    )


def _subframes(
    poses: SampledPoses, person: Person, rig: Rig, sensor: SensorTable, middle: Float[Array, "t V"]
) -> Int[Array, "t"]:
    """Number of sub-frames that keeps the motion between two of them under `subframe_px`.

    It is the largest motion of visible joints and, by the motion of the head, of the surroundings
    during the exposure of all views that share sub-frames.
    """
    span = sensor.shutter_s + sensor.readout_s
    half = span / 2
    first, last = middle - half, middle + half
    together = overlap_in_time(middle, span)[:, None]
    first = np.where(together, first.min(1, keepdims=True), first)
    last = np.where(together, last.max(1, keepdims=True), last)
    head = np.array(INDEX["head"])
    motion = np.zeros(len(middle))
    for v, mount in enumerate(rig.mounts):
        camera = mount.camera
        ends, heads = [], []
        for time in (first[:, v], last[:, v]):
            joints = _joints(poses, person, np.repeat(time[:, None], len(LABELS), 1))[1]
            ends.append(camera.project(_in_camera(mount.T_head_camera, joints)))
            heads.append(poses.at_bodies(time, head))
        (a, seen_a), (b, seen_b) = ends
        moved = np.linalg.norm(b - a, axis=-1)
        motion = np.maximum(motion, np.where(seen_a & seen_b, moved, 0.0).max(1))
        motion = np.maximum(motion, _surroundings_motion(camera, *heads))
    return np.clip(np.ceil(motion / sensor.subframe_px).astype(int), 1, sensor.subframes)


def _surroundings_motion(
    camera: Camera, before: Float[Array, "t 4 4"], after: Float[Array, "t 4 4"]
) -> Float[Array, "t"]:
    """Pixels by which the surroundings move in a camera between two poses of the head."""
    turn = inverse(before) @ after
    cosine = (np.trace(turn[:, :3, :3], axis1=1, axis2=2) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1)) + np.linalg.norm(turn[:, :3, 3], axis=1) / _FAR_M
    edge, _ = camera.radial.radius(np.float64(camera.max_angle))
    focal = np.sqrt(np.linalg.det(np.array(camera.affine))) * edge / camera.max_angle
    return angle * focal


def _in_camera(
    T_head_camera: Float[Array, "4 4"], points_head: Float[Array, "*n 3"]
) -> Float[Array, "*n 3"]:
    T = inverse(T_head_camera)
    return points_head @ T[:3, :3].T + T[:3, 3]
