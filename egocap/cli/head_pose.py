"""The command head-pose."""

from __future__ import annotations

import json as jsons
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE, progress
from egocap.errors import InputError
from egocap.head_pose.config import ForeignOptions, SfmConfig
from egocap.locks import locks
from egocap.odometry.config import OdometryConfig

if TYPE_CHECKING:
    from egocap.head_pose.result import HeadTrajectory

CONFIG, SFM, FOREIGN = OdometryConfig(), SfmConfig(), ForeignOptions()
Method = Literal["odometry", "sfm"]


@app.command(name="head-pose")
@locks("out")
def head_pose(
    sequence: Positional[Path],
    out: Path,
    method: Method = "odometry",
    settings: Annotated[OdometryConfig, tyro.conf.OmitArgPrefixes] = CONFIG,
    sfm: SfmConfig = SFM,
    track: Path | None = None,
    rig: Path | None = None,
    imu: Path | None = None,
    trajectory: Path | None = None,
    foreign: Annotated[ForeignOptions, tyro.conf.OmitArgPrefixes] = FOREIGN,
    json: bool = False,
) -> int:
    """Find where the head is in the world, from the pictures that are tracked.

    Writes what track --head-pose reads: z up, the floor at height 0, metres from the distance
    between the cameras. Frames whose pose cannot be measured are left out and listed.

    Args:
        sequence: folder of a sequence.
        out: head poses to write, npz.
        method: stereo odometry, or structure from motion (sfm): all frames adjusted together by
            COLMAP, the slow reference.
        settings: of the odometry.
        sfm: settings of the structure from motion.
        track: track of the sequence; its body masks the wearer, who is otherwise told by depth
            and motion.
        rig: rig file in place of the sequence's own rig.
        imu: CSV of a gyroscope and accelerometer on the head, timestamp_s,gx,gy,gz,ax,ay,az (rad/s,
            m/s^2; or EuRoC's), in any axes and clock: up is that of gravity where it is surer.
        trajectory: poses of another program in place of the pictures: TUM, EuRoC, COLMAP's
            images.txt, Aria's closed_loop_trajectory.csv, or CSV of ARKit or OpenXR.
        foreign: how that trajectory is read.
        json: print the summary as JSON.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap.data.sequence import Sequence

    opened = Sequence(sequence)
    cameras = opened.rig if rig is None else load_rig(rig)
    if trajectory is not None:
        if (track, imu, method, settings, sfm) != (None, None, "odometry", CONFIG, SFM):
            raise InputError("--track, --imu, --method or its settings with --trajectory",
                             valid="one of pictures and trajectory")  # fmt: skip
        from egocap.data.head_pose import require_near
        from egocap.head_pose.foreign import foreign_trajectory

        result = foreign_trajectory(trajectory, foreign, cameras, opened.times)
        require_near(trajectory, result.T_world_head)
    else:
        _refuse(foreign, method, settings, sfm)
        from egocap.data.track import load_track
        from egocap.head_pose.from_pictures import find_head_poses

        used = settings if method == "odometry" else sfm
        body = None if track is None else load_track(track)
        with progress("head pose", len(opened)) as advance:
            result = find_head_poses(opened, cameras, used, body, imu, advance)
    result.save(out)
    _print(out, result, len(opened), json)
    return DONE


def _refuse(
    foreign: ForeignOptions, method: Method, settings: OdometryConfig, sfm: SfmConfig
) -> None:
    """Options that the method would ignore."""
    if foreign != FOREIGN:
        raise InputError("--format, --reference or --time-offset without --trajectory",
                         valid="--trajectory FILE with them")  # fmt: skip
    if (settings if method == "sfm" else sfm) != (CONFIG if method == "sfm" else SFM):
        raise InputError(f"settings of another method with --method {method}",
                         valid="--sfm.* with sfm, the others with odometry")  # fmt: skip


def _print(path: Path, result: HeadTrajectory, frames: int, as_json: bool) -> None:
    import numpy as np

    from egocap.head_pose.rig_correction import correction_lines

    position = result.T_world_head[:, :3, 3]
    length = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
    summary: dict[str, Any] = {
        "head_pose": str(path), "frames": frames, "posed": len(result.time), "path_m": length,
        "gaps": [{"first": g.first, "last": g.last, "reason": g.reason} for g in result.gaps],
        **result.facts,
    }  # fmt: skip
    if result.covariance is not None:
        std = np.sqrt(np.trace(result.covariance[:, 3:, 3:], axis1=1, axis2=2))
        summary["position_std_end_mm"] = 1e3 * float(std[-1])
    if as_json:
        print(jsons.dumps(summary, indent=1))
        return
    print(f"{path}: {len(result.time)} of {frames} frames, path of {length:.1f} m")
    print(_origin(result.facts))
    for line in correction_lines(result.facts.get("self_calibration", {})):
        print(line)
    if "imu" in result.facts:
        told = result.facts["imu"]
        left = 1e3 * told["residual_m_s2"]
        print(f"IMU: clock offset {told['offset_s']:.4f} s; motion explained to {left:.0f} mm/s^2")
    for gap in result.gaps:
        print(f"no pose in frames {gap.first} to {gap.last}: {gap.reason}")


def _origin(facts: dict[str, Any]) -> str:
    """The world's vertical and floor, or the clock and place of a foreign trajectory."""
    if "vertical" in facts:
        found = facts["vertical"]
        floor = found["floor_std_mm"]
        known = "not found" if floor is None else f"to {floor:.2g} mm"
        return f"up from {found['up_from']}, to {found['up_std_deg']:.2g} degrees; floor {known}"
    told = [f"{facts['method']}: {facts['poses']} poses, clock offset {facts['offset_s']:.4f} s"]
    if "residual_mm" in facts:
        told.append(f"{facts['residual_mm']} mm and {facts['residual_deg']} degrees from the "
                    "reference")  # fmt: skip
        if facts["device_head_m"] is None:
            told.append("the device's place on the head is not observable: taken as the head's")
    return "; ".join(told)
