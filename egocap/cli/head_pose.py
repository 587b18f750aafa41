"""The command head-pose."""

from __future__ import annotations

import json as jsons
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from tyro.conf import Positional

from egocap.cli.registry import app
from egocap.commandline import DONE, progress
from egocap.odometry.config import OdometryConfig

if TYPE_CHECKING:
    from egocap.head_pose.result import HeadTrajectory

CONFIG = OdometryConfig()


@app.command(name="head-pose")
def head_pose(
    sequence: Positional[Path],
    out: Path,
    method: Literal["odometry"] = "odometry",
    settings: Annotated[OdometryConfig, tyro.conf.OmitArgPrefixes] = CONFIG,
    track: Path | None = None,
    rig: Path | None = None,
    json: bool = False,
) -> int:
    """Find where the head is in the world, from the pictures that are tracked.

    Writes what track --head-pose reads: z up, the floor at height 0, metres from the distance
    between the cameras. Frames whose pose cannot be measured are left out and listed.

    Args:
        sequence: folder of a sequence.
        out: head poses to write, npz.
        method: odometry: stereo visual odometry.
        settings: of the odometry.
        track: track of the sequence; its body masks the wearer, who is otherwise told by depth
            and motion.
        rig: rig file in place of the sequence's own rig.
        json: print the summary as JSON.
    """
    from egocap.cameras.rig_files import load_rig
    from egocap.data.sequence import Sequence
    from egocap.data.track import load_track
    from egocap.files import make_folder
    from egocap.head_pose.estimate import by_odometry, head_trajectory, vertical_of

    opened = Sequence(sequence)
    cameras = opened.rig if rig is None else load_rig(rig)
    body = None if track is None else load_track(track)
    make_folder(out.parent)
    with progress("head pose", len(opened)) as advance:
        found, reasons = by_odometry(opened, settings, cameras, body, advance)
    vertical = vertical_of(opened, cameras, settings, found)
    result = head_trajectory(found, reasons, len(opened), vertical)
    result.save(out)
    _print(out, result, len(opened), json)
    return DONE


def _print(path: Path, result: HeadTrajectory, frames: int, as_json: bool) -> None:
    import numpy as np

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
    facts = result.facts["vertical"]
    floor = facts["floor_std_mm"]
    known = "not found" if floor is None else f"from {facts['floor_from']}, to {floor:.2g} mm"
    print(f"up from {facts['up_from']}, to {facts['up_std_deg']:.2g} degrees; floor {known}")
    for gap in result.gaps:
        print(f"no pose in frames {gap.first} to {gap.last}: {gap.reason}")
