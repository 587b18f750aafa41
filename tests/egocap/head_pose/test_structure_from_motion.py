"""Structure from motion in a room of known pictures, and the poses between adjusted frames."""

from pathlib import Path

import numpy as np
import pytest

from egocap.errors import InputError, MachineError
from egocap.geometry import inverse
from egocap.head_pose import structure_from_motion as sfm
from egocap.head_pose.config import SfmConfig
from tests.egocap.head_pose.motion import head_motion
from tests.egocap.odometry.box_world import BoxWorld, small_rig, walk


class Footage:
    """What is read of a sequence, drawn when it is asked for."""

    folder = Path("drawn")

    def __init__(self, world, rig, poses):
        self.world, self.rig, self.poses = world, rig, poses
        self.times = np.arange(len(poses)) / 7.5

    def __len__(self):
        return len(self.poses)

    def image_suffix(self, index, view):
        return None

    def picture(self, index, view):
        grey = self.world.picture(self.rig, view, self.poses[index])
        return np.repeat(grey[..., None], 3, axis=2)


def test_a_walk_in_a_room_is_metric():
    poses = walk(48)[::4]
    footage = Footage(BoxWorld(), small_rig(), poses)
    advanced = []
    found = sfm.by_structure_from_motion(footage, SfmConfig(width=320, every=2), footage.rig, None,
                                         advanced.append)  # fmt: skip
    assert found.frame.tolist() == list(range(12)) and found.reasons == {}
    assert found.facts["adjusted"] == 7 and sum(advanced) > 6
    relative = inverse(found.T_map_head[0]) @ found.T_map_head
    true = inverse(poses[0]) @ poses
    path = np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()
    assert path > 1.2
    adjusted = [0, 2, 4, 6, 8, 10, 11]
    assert relative[adjusted, :3, 3] == pytest.approx(true[adjusted, :3, 3], abs=0.01)
    assert relative[adjusted, :3, :3] == pytest.approx(true[adjusted, :3, :3], abs=0.005)


def test_pictures_without_texture_are_refused():
    footage = Footage(BoxWorld(contrast=0.0), small_rig(160, 128), walk(6))
    with pytest.raises(InputError, match="no head pose in 6 frames: not registered"):
        sfm.by_structure_from_motion(footage, SfmConfig(every=1), footage.rig, None, print)


def test_without_pycolmap_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("egocap.errors.find_spec", lambda name: None)
    with pytest.raises(MachineError, match="pycolmap") as caught:
        sfm.by_structure_from_motion(None, SfmConfig(), None, None, print)
    assert "egocap[world]" in str(caught.value)


def test_splines_between_near_poses_and_a_gap_between_far_ones():
    times = np.arange(40) / 30.0
    true = head_motion(times)
    poses = {frame: true[frame] for frame in (0, 3, 6, 9, 12, 21, 24, 27, 30)}
    frames, found = sfm.between(poses, times, 3)
    assert frames.tolist() == [*range(13), *range(21, 31)]
    assert found[:, :3, 3] == pytest.approx(true[frames, :3, 3], abs=2e-3)
    assert found[[0, 3, 13]] == pytest.approx(true[[0, 3, 21]], abs=1e-9)
    alone, _ = sfm.between({5: true[5]}, times, 3)
    assert alone.tolist() == [5]


def test_a_setting_below_one_is_refused():
    with pytest.raises(InputError, match="below 1"):
        SfmConfig(every=0)
