"""Up and the floor of a room with known planes and exact pictures."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.geometry import inverse, rigid
from egocap.head_pose.floor import Pictured, find_floor
from egocap.head_pose.vertical import MEAN_UP_STD, Vertical, find_vertical, likely_verticals
from egocap.odometry.views import Motion, Views
from tests.egocap.odometry.box_world import BoxWorld, small_rig, walk

T_MAP_WORLD = rigid(Rotation.from_euler("xyz", [4.0, -7.0, 60.0], degrees=True).as_matrix(),
                    np.array([1.0, 2.0, -3.0]))  # fmt: skip
UP = T_MAP_WORLD[:3, 2]


def angle(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


def room(rng, count=400):
    """Points on two walls, a table and loose things, in the map."""
    u, v = rng.uniform(-2, 2, size=(2, count))
    walls = [np.stack([u, 0 * u + 2.5, 1 + 0.5 * v], -1), np.stack([0 * u - 2, v, 1 + 0.4 * u], -1)]
    table = np.stack([0.3 * u, 0.3 * v - 1, 0 * u + 0.75], -1)
    loose = rng.uniform([-2, -2, 0], [2, 2.5, 2], size=(count, 3))
    points = np.concatenate([*walls, table, loose]) + 0.003 * rng.normal(size=(4 * count, 3))
    return points @ T_MAP_WORLD[:3, :3].T + T_MAP_WORLD[:3, 3]


def test_up_is_what_planes_agree_on(rng):
    found = likely_verticals(room(rng), T_MAP_WORLD @ walk(30))[0]
    assert found.source == "planes"
    assert angle(found.up, UP) < 3 * np.degrees(found.up_std)
    assert angle(found.up, UP) < 1.0


def test_without_planes_up_is_that_of_the_head(rng):
    heads = T_MAP_WORLD @ walk(30)
    (found,) = likely_verticals(rng.uniform(-2, 2, size=(60, 3)), heads)
    assert found.source == "head"
    assert found.up_std == MEAN_UP_STD


def at_once(pictures):
    return Pictured(pictures, Motion.none(len(pictures)))


def pictured(rig, world, poses):
    """Some poses in the map, with their pictures of one instant."""
    return [(T_MAP_WORLD @ poses[i], at_once(world.pictures(rig, poses[i])))
            for i in (0, 13, 26, 39)]  # fmt: skip


@pytest.mark.parametrize("width, higher", [(320, 0.0), (640, 0.9)])  # and from a ladder
def test_the_floor_is_found_from_pictures(width, higher):
    rig, world, poses = small_rig(width, width * 4 // 5), BoxWorld(contrast=15.0), walk(40)
    poses[:, 2, 3] += higher
    frames = pictured(rig, world, poses)
    tilted = Rotation.from_euler("y", 1.5, degrees=True).as_matrix() @ UP
    found = find_floor(Views.of(rig, width), frames, tilted)
    assert angle(found.normal, UP) < max(3 * np.degrees(found.normal_std), 0.3)
    assert found.normal_std < np.deg2rad(0.5)
    for T, pose in zip((T for T, _ in frames), poses[[0, 13, 26, 39]], strict=True):
        assert T[:3, 3] @ found.normal - found.height == pytest.approx(pose[2, 3], abs=0.02)


@pytest.mark.parametrize("off", [20.0, -20.0])
def test_the_floor_is_found_from_a_direction_far_off(off):
    """One sweep along it finds something between the two."""
    rig, world, poses = small_rig(640, 512), BoxWorld(contrast=15.0), walk(40)
    start = Rotation.from_euler("y", off, degrees=True).as_matrix() @ UP
    found = find_floor(Views.of(rig, 640), pictured(rig, world, poses), start)
    assert angle(found.normal, UP) < 0.2


@pytest.mark.parametrize("told", [True, False])
def test_the_floor_is_found_from_pictures_of_different_times(told):
    """Of a walking head, whose right picture is taken a frame later: untold, the floor tilts."""
    rig, world, poses = small_rig(640, 512), BoxWorld(contrast=15.0), walk(41, speed=1.5)
    frames = []
    for i in (0, 13, 26, 39):
        pictures = world.picture(rig, 0, poses[i]), world.picture(rig, 1, poses[i + 1])
        turn = Rotation.from_matrix(poses[i, :3, :3].T @ poses[i + 1, :3, :3]).as_rotvec()
        moved = poses[i, :3, :3].T @ (poses[i + 1] - poses[i])[:3, 3]
        motion = Motion(30.0 * np.concatenate([turn, moved]), np.array([0.0, 1 / 30.0]))
        still = Motion.none(2)
        frames.append((T_MAP_WORLD @ poses[i], Pictured(pictures, motion if told else still)))
    found = find_floor(Views.of(rig, 640), frames, UP)
    assert bool(angle(found.normal, UP) < 0.1) is told


def test_slanted_planes_do_not_decide_where_pictures_show_a_floor(rng):
    """As on stairs: two slopes and what is at right angles to them outnumber the level things."""
    rig, world, poses = small_rig(640, 512), BoxWorld(contrast=15.0), walk(40)
    frames = pictured(rig, world, poses)
    turn = Rotation.from_euler("x", 18.0, degrees=True).as_matrix()
    u, v, w = rng.uniform(-2, 2, size=(3, 300))
    planes = [np.stack([u, v, 0 * u], -1), np.stack([u, v, 0 * u + 1.0], -1),
              np.stack([u, 0 * u + 1.5, w], -1)]  # fmt: skip
    slanted = (np.concatenate(planes) + 0.002 * rng.normal(size=(900, 3))) @ turn.T
    points = slanted @ T_MAP_WORLD[:3, :3].T + T_MAP_WORLD[:3, 3]
    heads = T_MAP_WORLD @ poses
    assert 15.0 < angle(likely_verticals(points, heads)[0].up, UP) < 20.0
    found = find_vertical(Views.of(rig, 640), points, heads, frames)
    assert found.source == "the floor" and found.floor is not None
    assert angle(found.up, UP) < 0.3


def test_no_floor_is_invented():
    rig, poses = small_rig(), walk(20)
    blank = tuple(np.full((256, 320), 120, np.uint8) for _ in range(2))
    noise = np.random.default_rng(1)
    for i in range(2):
        pictures = (
            blank if i else tuple(noise.integers(0, 255, b.shape).astype(np.uint8) for b in blank)
        )
        assert (
            find_floor(Views.of(rig, 320), [(poses[0], at_once(pictures))] * 3, UP * 0 + [0, 0, 1])
            is None
        )


def test_the_world_has_z_up_and_the_floor_at_zero():
    head = T_MAP_WORLD @ walk(1)[0]
    vertical = Vertical(UP, 0.0, "planes", floor=float(T_MAP_WORLD[:3, 3] @ UP))
    T = vertical.transform(head)
    assert T[:3, :3] @ UP == pytest.approx([0, 0, 1])
    moved = T @ head
    assert moved[:3, 3] == pytest.approx([0, 0, walk(1)[0][2, 3]])
    assert moved[1, 0] == pytest.approx(0.0, abs=1e-12)
    assert np.allclose(T @ inverse(T), np.eye(4))
