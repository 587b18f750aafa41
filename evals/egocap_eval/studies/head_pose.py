"""Head poses found from the pictures alone, against the truth: path, rotation, up, floor and time.

By stereo odometry, offline and live, and, for some cases, by structure from motion beside it, the
offline reference. Live poses, of earlier pictures alone, begin once up and the floor are found.
Cases are validation scenes with procedural motion. Position errors are given with the first pose
aligned (drift shows in full) and with all poses aligned by one rigid motion, never by a scale.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from tyro.conf import arg

from egocap.commandline import progress
from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap.geometry import inverse, unit
from egocap.head_pose.config import SfmConfig
from egocap.head_pose.from_pictures import find_head_poses
from egocap.head_pose.imu import vertical_by_imu
from egocap.head_pose.imu_files import read_imu
from egocap.head_pose.online import OnlineHeadPose
from egocap.head_pose.result import HeadTrajectory
from egocap.odometry.config import OdometryConfig
from egocap_eval.harness.footage import builtin_scene, content_hashes, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_sim.export.imu import write_imu
from egocap_sim.sensor.config import SensorTable


@dataclass(frozen=True)
class Case:
    """A scene, frames in which a hand covers the lenses, and a preset of the sensor."""

    scene: str
    frames: int
    covered: range = range(0)
    sensor: str | None = None  # the scene's own


CASES: Mapping[str, Case] = {
    "walk": Case("validation-walk", 250),
    "minute": Case("validation-walk", 1800),
    "covered": Case("validation-walk", 1800, range(800, 1100)),
    "consumer": Case("validation-walk", 900, sensor="consumer"),
    "street": Case("walk", 300),
    "stairs": Case("stairs", 300),
}
"""The street has two people walking by."""

MOST_MM, MOST_DEG, MOST_DRIFT, MOST_CPU_MS = 10.0, 0.3, 0.3, 2e3 / 15.0
"""Targets: position and rotation rms, drift in percent of the path, 15 frames/s on two cores."""


def study(
    work: Annotated[Path, arg(metavar="DIR")] = Path("out/head-pose"),
    cases: tuple[str, ...] = tuple(CASES),
    sfm: tuple[str, ...] = ("walk", "stairs"),
    size: tuple[int, int] = (640, 512),
    workers: int = 1,
) -> Outcome:
    """Find the head's path in the world from pictures, against the truth.

    Args:
        work: Folder of sequences, which are made where they are missing.
        cases: Cases to measure.
        sfm: Cases that structure from motion solves too, where they are among those.
        size: Image width and height.
        workers: Rendering processes.
    """
    if unknown := [case for case in (*cases, *sfm) if case not in CASES]:
        raise InputError(f"unknown case '{unknown[0]}'", valid=CASES)
    found, live, by_sfm, sequences = {}, {}, {}, []
    for name in cases:
        case = CASES[name]
        scene = builtin_scene(case.scene, size, frames=case.frames)
        title = f"{case.scene}-{case.frames}"
        if case.sensor is not None:
            sensor = SensorTable.model_validate({"preset": case.sensor})
            scene, title = scene.model_copy(update={"sensor": sensor}), f"{title}-{case.sensor}"
        folder = work / "sequences" / title
        prepare_sequence(scene, folder, workers)
        sequence = Covered(folder, case.covered)
        sequences.append(sequence)
        imu = work / "imu" / f"{folder.name}.csv"
        found[name] = measure(sequence, name, imu, OdometryConfig())
        live[name] = measure_live(sequence, name)
        if name in sfm:
            by_sfm[name] = measure(sequence, f"{name}, sfm", imu, SfmConfig())
    missed = [f"{name}: {what}" for name, row in found.items() for what in misses(row)]
    missed += [
        f"{name}: {what}" for name, row in by_sfm.items() for what in behind(found[name], row)
    ]
    others = {f"{name}, live": row for name, row in live.items()}
    others |= {f"{name}, sfm": row for name, row in by_sfm.items()}
    result = {"cases": found, "live": live, "sfm": by_sfm}
    return Outcome(result, [_table(found | others)], missed, content_hashes(sequences))


class Covered(Sequence):
    """A sequence without the pictures of some frames."""

    def __init__(self, folder: Path, covered: range) -> None:
        super().__init__(folder)
        self.covered = covered

    def image_suffix(self, index: int, view: int) -> str | None:
        """As `Sequence`, None in covered frames."""
        return None if index in self.covered else super().image_suffix(index, view)

    def picture(self, index: int, view: int, reduction: int = 1) -> UInt8[Array, "h w 3"] | None:
        """As `Sequence`, None in covered frames."""
        return None if index in self.covered else super().picture(index, view, reduction)


def measure(
    sequence: Covered, name: str, imu: Path, config: OdometryConfig | SfmConfig
) -> dict[str, Any]:
    """Score the poses of a sequence by a method, and up by a simulated IMU's file."""
    spent = time.process_time()
    with progress(name, len(sequence)) as advance:
        result = find_head_poses(sequence, sequence.rig, config, advance=advance)
    spent = time.process_time() - spent
    scores = score(result, sequence.truth.T_world_head)
    return {"frames": len(sequence) - len(sequence.covered), "posed": len(result.time),
            "gaps": len(result.gaps), **scores,
            **inertial_scores(result, sequence, imu), **result.facts,
            "cpu_ms_per_frame": 1e3 * spent / len(sequence)}  # fmt: skip


def measure_live(sequence: Covered, name: str) -> dict[str, Any]:
    """Score the poses that a live run would have, picture by picture."""
    head, views = OnlineHeadPose(sequence.rig, waits=True), range(len(sequence.rig.mounts))
    poses, spent = {}, time.process_time()
    with closing(head), progress(f"{name}, live", len(sequence)) as advance:
        for i, when in enumerate(sequence.times):
            T = head.step([sequence.picture(i, v) for v in views], float(when))
            poses |= {} if T is None else {i: T}
            advance(1)
    spent = time.process_time() - spent
    row = head.facts() | {"frames": len(sequence) - len(sequence.covered),
                          "cpu_ms_per_frame": 1e3 * spent / len(sequence)}  # fmt: skip
    frame = np.array(list(poses), int)
    if len(frame) < 2:
        return row
    found = HeadTrajectory(frame, sequence.times[frame], np.stack([*poses.values()]))
    return row | score(found, sequence.truth.T_world_head)


def score(result: HeadTrajectory, truth: Float[Array, "T 4 4"]) -> dict[str, float | None]:
    """Errors of the poses that were found; up and floor in the result's own world."""
    true, found = truth[result.frame], result.T_world_head
    moved = (true[0] @ inverse(found[0])) @ found
    off = np.linalg.norm(moved[:, :3, 3] - true[:, :3, 3], axis=1)
    path = float(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum())
    R, rest, scale = rigid_fit(found[:, :3, 3], true[:, :3, 3])
    up = true_up(result, truth)
    std = 0.0 if result.covariance is None else _position_std(result.covariance[-1])
    return {
        "path_m": path,
        "first_aligned_mm": _rms_mm(off),
        "all_aligned_mm": _rms_mm(rest),
        "worst_mm": float(1e3 * off.max()),
        "rotation_deg": _rms_deg(moved[:, :3, :3], true[:, :3, :3]),
        "rotation_all_aligned_deg": _rms_deg(R @ found[:, :3, :3], true[:, :3, :3]),
        "drift_percent": 100.0 * float(off[-1]) / path,
        "scale_error_percent": 100.0 * (scale - 1.0),
        "up_error_deg": float(np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2]))),
        "height_error_mm": float(1e3 * (found[:, 2, 3] - true[:, 2, 3]).mean()),
        "end_error_in_std": float(off[-1]) / std if std > 0 else None,
    }


def _position_std(covariance: Float[Array, "6 6"]) -> float:
    return float(np.sqrt(np.trace(covariance[3:, 3:])))


def true_up(result: HeadTrajectory, truth: Float[Array, "T 4 4"]) -> Float[Array, "3"]:
    """The mean over the poses of what was up in truth, in the result's world."""
    turned = np.swapaxes(truth[result.frame, :3, :3], 1, 2)
    return unit((result.T_world_head[:, :3, :3] @ turned).mean(0)[:, 2])


def inertial_scores(
    result: HeadTrajectory, sequence: Sequence, file: Path
) -> dict[str, float | None]:
    """Up and clock by an IMU that is simulated once, without the floor and walls.

    None where the poses are too few to find its clock.
    """
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        write_imu(sequence, file, lambda _: None)
    try:
        inertial = vertical_by_imu(result.time, result.T_world_head, read_imu(file))
    except InputError:
        return dict.fromkeys(("imu_up_error_deg", "imu_up_std_deg", "imu_clock_error_ms"))
    off = float(np.clip(inertial.vertical.up @ true_up(result, sequence.truth.T_world_head), -1, 1))
    return {"imu_up_error_deg": float(np.degrees(np.arccos(off))),
            "imu_up_std_deg": float(np.degrees(inertial.vertical.up_std)),
            "imu_clock_error_ms": 1e3 * inertial.offset_s}  # fmt: skip


def rigid_fit(
    found: Float[Array, "N 3"], true: Float[Array, "N 3"]
) -> tuple[Float[Array, "3 3"], Float[Array, "N"], float]:
    """Rotation, remaining distances [m] of the best rigid motion, and the best scale beside it.

    Source: Umeyama 1991.
    """
    a, b = found - found.mean(0), true - true.mean(0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    turned = a @ R.T
    return R, np.linalg.norm(turned - b, axis=1), float((turned * b).sum() / (a**2).sum())


def misses(row: Mapping[str, Any]) -> list[str]:
    """Which targets a row misses, in words."""
    limits = (("first_aligned_mm", MOST_MM, "mm"), ("rotation_deg", MOST_DEG, "degrees"),
              ("drift_percent", MOST_DRIFT, "% drift"),
              ("cpu_ms_per_frame", MOST_CPU_MS, "CPU ms a frame"))  # fmt: skip
    missed = [f"{row[key]:.3g} {unit} (target {limit:.3g})"
              for key, limit, unit in limits if row[key] > limit]  # fmt: skip
    if row["posed"] < row["frames"]:
        missed.append(f"{row['frames'] - row['posed']} frames without a pose")
    return missed


def behind(odometry: Mapping[str, Any], sfm: Mapping[str, Any]) -> list[str]:
    """Where the odometry's error is more than twice that of structure from motion, in words."""
    return [f"{row:.3g} {unit} by odometry (target twice {other:.3g}, structure from motion)"
            for key, unit in (("all_aligned_mm", "mm"), ("rotation_all_aligned_deg", "degrees"))
            if (row := odometry[key]) > 2.0 * (other := sfm[key])]  # fmt: skip


def _rms_mm(distances: Float[Array, "N"]) -> float:
    return float(1e3 * np.sqrt((distances**2).mean()))


def _rms_deg(a: Float[Array, "N 3 3"], b: Float[Array, "N 3 3"]) -> float:
    cosine = (np.einsum("nij,nij->n", a, b) - 1.0) / 2.0
    return float(np.degrees(np.sqrt((np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2).mean())))


_COLUMNS = (
    ("path m", "path_m", 1), ("mm, first aligned", "first_aligned_mm", 1),
    ("mm, all aligned", "all_aligned_mm", 1), ("degrees", "rotation_deg", 3),
    ("drift %", "drift_percent", 3), ("scale error %", "scale_error_percent", 3),
    ("up error degrees", "up_error_deg", 2), ("by IMU", "imu_up_error_deg", 3),
    ("stated", "imu_up_std_deg", 3), ("clock error ms", "imu_clock_error_ms", 2),
    ("height error mm", "height_error_mm", 0),
    ("end error in std", "end_error_in_std", 1), ("CPU ms a frame", "cpu_ms_per_frame", 0),
)  # fmt: skip


def _table(found: Mapping[str, Mapping[str, Any]]) -> Table:
    rows = tuple(
        (name, f"{row['posed']} of {row['frames']}",
         *(number(row.get(key), digits) for _, key, digits in _COLUMNS))
        for name, row in found.items()
    )  # fmt: skip
    heads = ("case", "frames with a pose", *(head for head, *_ in _COLUMNS))
    return Table("Head pose in the world, from the pictures alone", heads, rows)
