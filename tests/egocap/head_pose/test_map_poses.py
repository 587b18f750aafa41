"""Parts of a recording against the whole that they were cut from."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.data.sequence import Sequence
from egocap.geometry import inverse, rigid
from egocap.head_pose import estimate, map_poses
from egocap.head_pose.from_pictures import find_head_poses
from egocap.head_pose.map_poses import APART, MapPoses, joined_parts, overlapping, turned
from egocap.odometry.config import OdometryConfig

FACTS = {"method": "odometry", "parts": 1, "keyframes": 10, "points": 2, "segments": 1,
         "joined": 0, "loops": 1, "noise_factor": 1.2}  # fmt: skip


def path(frames=120):
    """A head that walks a bend and nods."""
    s = np.linspace(0.0, 3.0, frames)
    R = Rotation.from_euler("zy", np.stack([40.0 * s, 10.0 * np.sin(4 * s)], 1), degrees=True)
    return rigid(R.as_matrix(), np.stack([2.0 * s, np.sin(s), 1.6 + 0.05 * np.sin(9 * s)], 1))


def part(T, rows, pose, noise_m=0.0, rng=None):
    """Poses of some frames in a map that lies elsewhere."""
    found = pose @ T[rows]
    if noise_m:
        found[:, :3, 3] += noise_m * rng.normal(size=(len(rows), 3))
    points = np.array([[3.0, 0.0, 1.0], [0.0, 2.0, 0.0]]) @ pose[:3, :3].T + pose[:3, 3]
    covariance = np.tile(1e-6 * np.eye(6), (len(rows), 1, 1))
    return MapPoses(np.array(rows), np.array(rows) / 30.0, found, covariance, points,
                    SimpleNamespace(), dict(FACTS), {}, {rows[0]: (None, None)})  # fmt: skip


def elsewhere(rng):
    return rigid(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))


def test_parts_of_a_path_are_that_path(rng):
    T = path()
    rows = [[*range(50)], [*range(30, 90)], [*range(70, 120)]]
    poses = [np.eye(4), elsewhere(np.random.RandomState(1)), elsewhere(np.random.RandomState(2))]
    whole = joined_parts([part(T, r, p) for r, p in zip(rows, poses, strict=True)])
    assert whole.frame.tolist() == [*range(120)]
    np.testing.assert_allclose(whole.T_map_head, T, atol=1e-9)
    np.testing.assert_allclose(whole.points, np.tile(whole.points[:2], (3, 1)), atol=1e-9)
    assert set(whole.pictures) == {0, 30, 70}
    assert whole.facts == FACTS | {"parts": 3, "keyframes": 30, "points": 6, "loops": 3}


def test_frames_that_one_part_misses_come_from_the_other(rng):
    T = path()
    first = [i for i in range(60) if i not in (42, 43)]
    second = [i for i in range(30, 120) if i not in (50, 51, 80)]
    whole = joined_parts([part(T, first, np.eye(4)), part(T, second, elsewhere(rng_state()))])
    assert whole.frame.tolist() == [i for i in range(120) if i != 80]
    np.testing.assert_allclose(whole.T_map_head, T[whole.frame], atol=1e-9)


def rng_state():
    return np.random.RandomState(3)


def test_the_path_passes_from_one_part_to_the_next(rng):
    """Noise of millimetres makes no step where they meet."""
    T = path()
    shift = rigid(np.eye(3), np.array([0.004, 0.0, 0.0]))
    second = part(T, [*range(40, 120)], np.eye(4))
    second.T_map_head[:25] = shift @ second.T_map_head[:25]  # they disagree about the first ones
    whole = joined_parts([part(T, [*range(70)], np.eye(4)), second])
    steps = np.diff((whole.T_map_head - T)[:, :3, 3], axis=0)
    assert np.abs(steps).max() < 0.0035


def test_parts_without_a_link_are_left_out_with_a_reason():
    T = path()
    short, long = part(T, [*range(40)], np.eye(4)), part(T, [*range(30, 120)], np.eye(4))
    whole = joined_parts([short, long])
    assert whole.frame.tolist() == [*range(30, 120)]
    assert {whole.reasons[i] for i in range(30)} == {APART}


def test_covariances_hold_what_the_joint_adds(rng):
    """Against poses that follow a joint whose pose is drawn from its covariance."""
    T = path()
    A = 0.01 * rng.normal(size=(6, 6))
    of_joint, own = A @ A.T, np.tile(1e-12 * np.eye(6), (len(T), 1, 1))
    found = map_poses._carried(of_joint, T[20], own, T)
    draws = rng.multivariate_normal(np.zeros(6), of_joint, 4000)
    moved = T[20] @ rigid(Rotation.from_rotvec(draws[:, :3]).as_matrix(), np.zeros(3))
    moved[:, :3, 3] += draws[:, 3:]
    later = moved @ inverse(T[20]) @ T[100]
    turn = Rotation.from_matrix(T[100, :3, :3].T @ later[:, :3, :3]).as_rotvec()
    seen = np.cov(np.concatenate([turn, later[:, :3, 3]], 1).T)
    np.testing.assert_allclose(seen, found[100], atol=0.1 * np.abs(found[100]).max())


def test_a_turned_covariance_keeps_the_rotation(rng):
    T = elsewhere(rng_state())
    found = turned(np.diag([1.0, 2.0, 3.0, 1.0, 1.0, 4.0])[None], T)[0]
    np.testing.assert_allclose(found[:3, :3], np.diag([1.0, 2.0, 3.0]))
    R = T[:3, :3]
    np.testing.assert_allclose(found[3:, 3:], R @ np.diag([1.0, 1.0, 4.0]) @ R.T, atol=1e-12)


@pytest.mark.parametrize("frames", [1, 500, 3090, 3091, 20_000])
def test_ranges_cover_everything_and_overlap(frames):
    found = overlapping(frames, 3000, 90)
    assert (found[0].start, found[-1].stop) == (0, frames)
    assert all(b.start == a.stop - 90 for a, b in pairwise(found))
    assert max(map(len, found)) <= 3090


def test_a_recording_in_parts_has_the_path_of_the_whole(tiny_sequence, monkeypatch):
    sequence = Sequence(tiny_sequence)
    settings = OdometryConfig(self_calibration=False)
    whole = find_head_poses(sequence, sequence.rig, settings)
    monkeypatch.setattr(estimate, "LONGEST", 4)
    monkeypatch.setattr(estimate, "OVERLAP", 2)
    monkeypatch.setattr(map_poses, "FEWEST_SHARED", 1)
    advanced = []
    found = find_head_poses(sequence, sequence.rig, settings, advance=advanced.append)
    assert (found.facts["parts"], sum(advanced)) == (4, len(sequence))
    assert found.frame.tolist() == whole.frame.tolist()
    np.testing.assert_allclose(found.T_world_head, whole.T_world_head, atol=0.01)
