"""Head poses of a file: between the known ones, at their ends, and what is wrong with them."""

import numpy as np
import pytest

from egocap.data.head_pose import (
    HeadPoses,
    head_poses_at,
    in_world,
    interpolate_poses,
    load_head_pose,
    load_surroundings,
    read_head_poses,
)
from egocap.errors import FileError, InputError
from egocap.files import read_npz
from egocap.geometry import axis_angle, rigid, transform
from tests.egocap.data.test_bvh import made

AXIS = np.array([0.0, 0.0, 1.0])


def known(count=5):
    times = np.arange(count) / 10
    return times, rigid(axis_angle(AXIS, 0.3 * np.arange(count)), np.outer(times, [1.0, 2.0, 3.0]))


def test_between_known_poses_the_head_turns_and_moves_evenly():
    times, poses = known()
    at = interpolate_poses(np.array([0.05, 0.12]), times, poses)
    expected = rigid(axis_angle(AXIS, np.array([0.15, 0.36])),
                     np.outer([0.05, 0.12], [1, 2, 3]))  # fmt: skip
    assert np.allclose(at, expected)
    assert np.allclose(interpolate_poses(times, times, poses), poses)


def test_beyond_the_known_poses_is_an_error():
    times, poses = known()
    assert np.allclose(interpolate_poses(np.array([0.0, 0.45]), times, poses)[1], poses[-1])
    with pytest.raises(InputError, match=r"0 to 0\.4 s"):
        interpolate_poses(np.array([0.0, 0.8]), times, poses)


def test_poses_of_frames_are_filled_from_the_nearest():
    _, poses = known()
    found = HeadPoses.of([None, poses[1], None, None, None, poses[4]])
    assert found.known.tolist() == [False, True, False, False, False, True]
    np.testing.assert_array_equal(found.T_world_head, poses[[1, 1, 1, 1, 4, 4]])
    assert HeadPoses.of([None, None]) is None


def test_points_of_the_surroundings_are_optional_and_checked(tmp_path):
    times, poses = known()
    path, points = tmp_path / "head.npz", np.ones((3, 3), np.float32)
    np.savez(path, time=times, T_world_head=poses)
    assert load_surroundings(path).shape == (0, 3)
    np.savez(path, time=times, T_world_head=poses, points=points)
    np.testing.assert_array_equal(load_surroundings(path), points)
    for wrong in (points[:, :2], np.full((2, 3), np.nan), np.ones((2, 3), int)):
        np.savez(path, time=times, T_world_head=poses, points=wrong)
        with pytest.raises(FileError, match="points"):
            load_surroundings(path)


def test_joints_move_into_the_world(tmp_path):
    track = made(frames=11)
    times, poses = known()
    np.savez(tmp_path / "head.npz", time=times, T_world_head=poses, more=np.ones(3))
    result = in_world(track, read_head_poses(tmp_path / "head.npz", track.times))
    assert result.in_world.all()
    assert np.allclose(result.joints_world, transform(result.T_world_head, track.joints_head))


def test_a_gap_is_not_interpolated():
    times, poses = known(9)
    kept = [0, 1, 2, 6, 7, 8]
    at = np.arange(25) / 30
    found = head_poses_at(at, times[kept], poses[kept])
    inside = (at > 0.2 + 1e-9) & (at < 0.6 - 1e-9)
    assert np.array_equal(found.known, ~inside)
    whole = interpolate_poses(at, times, poses)
    assert np.allclose(found.T_world_head[found.known], whole[found.known])
    held = np.isclose(found.T_world_head[inside][:, None], poses[[2, 6]]).all((2, 3))
    assert held.any(1).all()


@pytest.mark.parametrize("rounding", [0.0, 1e-9, -1e-9])
def test_poses_at_the_ends_of_a_gap_are_known(rounding):
    times, poses = known(20)
    kept = [0, 1, 2, 3, 9, 15, 16, 17, 18, 19]
    found = head_poses_at(times, times[kept] + rounding, poses[kept])
    assert np.flatnonzero(found.known).tolist() == kept
    np.testing.assert_allclose(found.T_world_head[kept], poses[kept], atol=1e-6)


def test_frames_outside_the_known_poses_are_a_gap():
    times, poses = known()
    found = head_poses_at(np.array([-0.3, 0.1, 0.9]), times, poses)
    assert found.known.tolist() == [False, True, False]
    with pytest.raises(InputError, match=r"0 to 0\.4 s"):
        head_poses_at(np.array([7.0, 8.0]), times, poses)


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"time": None}, "time"), ({"time": np.zeros(5)}, "increase"),
     ({"T_world_head": np.zeros((5, 4, 4))}, "rigid"), ({"T_world_head": np.eye(4)}, "shape"),
     ({"T_world_head": np.full((5, 4, 4), np.nan)}, "finite"),
     ({"T_world_head": np.full((5, 4, 4), 1e200)}, "too large"),
     ({"T_world_head": np.tile(rigid(np.eye(3), [1.1e5, 0, 0]), (5, 1, 1))}, "from the origin"),
     ({"time": np.arange(5)}, "numbers")],
)  # fmt: skip
def test_bad_files_name_the_array(tmp_path, changes, says):
    times, poses = known()
    arrays = {"time": times, "T_world_head": poses} | changes
    np.savez(tmp_path / "h.npz", **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(FileError, match=says):
        load_head_pose(tmp_path / "h.npz")


def test_a_file_may_state_where_the_floor_is(tmp_path):
    times, poses = known()
    np.savez(tmp_path / "h.npz", time=times, T_world_head=poses)
    assert read_head_poses(tmp_path / "h.npz", times).floor_std is None
    np.savez(tmp_path / "h.npz", time=times, T_world_head=poses, floor_std=0.004)
    found = read_head_poses(tmp_path / "h.npz", times)
    assert found.floor_std == found[1:3].floor_std == 0.004
    for wrong in (-1.0, np.nan, 1, [0.1, 0.2]):
        np.savez(tmp_path / "h.npz", time=times, T_world_head=poses, floor_std=wrong)
        with pytest.raises(FileError, match="floor_std"):
            read_head_poses(tmp_path / "h.npz", times)


def test_a_file_is_opened_once(tmp_path, monkeypatch):
    times, poses = known()
    np.savez(tmp_path / "h.npz", time=times, T_world_head=poses, floor_std=0.004)
    opened = []
    monkeypatch.setattr("egocap.data.head_pose.read_npz",
                        lambda path, only: opened.append(path) or read_npz(path, only))  # fmt: skip
    read_head_poses(tmp_path / "h.npz", times)
    assert len(opened) == 1


def test_garbage_is_a_file_error(tmp_path):
    (tmp_path / "h.npz").write_bytes(b"PK\x03\x04nonsense")
    with pytest.raises(FileError):
        load_head_pose(tmp_path / "h.npz")
    with pytest.raises(FileError, match="no such file"):
        load_head_pose(tmp_path / "none.npz")
