"""Head poses of a sequence from its pictures: poses in a map of points, then up and the floor."""

from __future__ import annotations

from pathlib import Path

from egocap.cameras.rig import Rig
from egocap.data.sequence import Sequence
from egocap.data.track import Track
from egocap.head_pose.config import SfmConfig
from egocap.head_pose.estimate import Advance, by_odometry, head_trajectory, vertical_of
from egocap.head_pose.imu import vertical_by_imu
from egocap.head_pose.imu_files import read_imu
from egocap.head_pose.result import HeadTrajectory
from egocap.head_pose.structure_from_motion import by_structure_from_motion
from egocap.odometry.config import OdometryConfig
from egocap.odometry.self_calibration import RigSearch


def find_head_poses(
    sequence: Sequence,
    rig: Rig,
    settings: OdometryConfig | SfmConfig = OdometryConfig(),  # noqa: B008 (frozen)
    track: Track | None = None,
    imu: Path | None = None,
    advance: Advance = lambda frames: None,
    search: RigSearch | None = None,
) -> HeadTrajectory:
    """Head poses in the world, by odometry or by structure from motion as `settings` say.

    Args:
        sequence: whose pictures are followed.
        rig: its cameras, two or more.
        settings: of the odometry, or of structure from motion.
        track: track of the sequence, whose body masks the wearer.
        imu: CSV of a gyroscope and accelerometer on the head.
        advance: called with the number of frames just finished.
        search: for errors of the rig, for the odometry, in place of its own.

    Raises:
        FileError: the IMU's file is damaged.
        InputError: a rig of one view, or no frame has a pose.
        MachineError: structure from motion without pycolmap.
    """
    sensor = None if imu is None else read_imu(imu)
    if isinstance(settings, SfmConfig):
        found = by_structure_from_motion(sequence, settings, rig, track, advance)
    else:
        found = by_odometry(sequence, settings, rig, track, advance, search)
    inertial = None if sensor is None else vertical_by_imu(found.time, found.T_map_head, sensor)
    vertical = vertical_of(found, None if inertial is None else inertial.vertical)
    return head_trajectory(found, len(sequence), vertical, inertial)
