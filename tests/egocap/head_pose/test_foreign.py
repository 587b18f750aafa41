"""Trajectories of other programs at the times of frames."""

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.data.head_pose import head_poses_at
from egocap.errors import FileError
from egocap.head_pose.config import ForeignOptions
from egocap.head_pose.foreign import foreign_trajectory
from egocap_sim.core.resources import builtin_file
from tests.egocap.head_pose.motion import head_motion, quaternions

TIMES = np.arange(60) / 30.0


@pytest.mark.parametrize("offset", [0.0, 0.1])
def test_poses_on_either_side_of_a_gap_are_kept(tmp_path, offset):
    """Those whose times are the frames': as of head poses from a file."""
    kept = np.r_[0:10, 25, 40:60]
    poses = head_motion(TIMES)[kept]
    rows = np.concatenate([poses[:, :3, 3], quaternions(poses[:, :3, :3])], 1)
    lines = [f"{t - offset:.9f} " + " ".join(f"{v:.9f}" for v in row)
             for t, row in zip(TIMES[kept], rows, strict=True)]  # fmt: skip
    path = tmp_path / "head.tum"
    path.write_text("\n".join(lines))
    rig = load_rig(builtin_file("rig", "egorig1"))
    found = foreign_trajectory(path, ForeignOptions(time_offset=offset), rig, TIMES)
    np.testing.assert_array_equal(found.frame, kept)
    assert [(gap.first, gap.last) for gap in found.gaps] == [(10, 24), (26, 39)]
    known = head_poses_at(TIMES, TIMES[kept], poses).known
    np.testing.assert_array_equal(np.flatnonzero(known), kept)


@pytest.mark.parametrize("name", ["000060", "9" * 30])
def test_pictures_of_other_frames_are_refused(tmp_path, name):
    path = tmp_path / "images.txt"
    path.write_text(f"1 1 0 0 0 0 0 0 1 left/000000.png\n\n2 1 0 0 0 0 0 0 1 left/{name}.png\n\n")
    rig = load_rig(builtin_file("rig", "egorig1"))
    with pytest.raises(FileError, match="pictures named by frame, 0 to 59"):
        foreign_trajectory(path, ForeignOptions(format="colmap"), rig, TIMES)
