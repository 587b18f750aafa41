"""Odometry on exact pictures of a box: known poses, and inputs without a pose."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.geometry import inverse, rigid
from egocap.odometry.config import OdometryConfig
from egocap.odometry.finish import finish
from egocap.odometry.odometry import Odometry, is_wearer
from egocap.odometry.ray_kernel import exponential
from egocap.odometry.views import Views
from tests.egocap.odometry.box_world import BoxWorld, apart, small_rig, walk

RIG = small_rig()
WORLD = BoxWorld()
CONFIG = OdometryConfig(width=320, corners=150)


def run(poses, change=None, config=CONFIG):
    """Results of every frame of pictures taken at these poses, changed by change(i, pictures)."""
    odometry = Odometry(Views.of(RIG, config.width), config)
    found = []
    for i, T in enumerate(poses):
        pictures = WORLD.pictures(RIG, T)
        pictures = pictures if change is None else change(i, pictures)
        found.append(odometry.add(i, i / 30.0, pictures))
    return odometry, found


def errors(poses, found, first=0):
    """Distances [m] and angles [rad] between poses, the first known ones aligned."""
    known = [i for i, f in enumerate(found) if f.T_world_head is not None and i >= first]
    return apart(poses[known], np.stack([found[i].T_world_head for i in known]))


@pytest.fixture(scope="module")
def walked():
    poses = walk(36)
    return poses, *run(poses)


def test_a_walk_is_followed_to_millimetres(walked):
    poses, _, found = walked
    assert all(f.T_world_head is not None for f in found)
    distance, angle = errors(poses, found)
    assert distance.max() < 0.006
    assert angle.max() < np.deg2rad(0.15)


def test_the_whole_recording_is_adjusted_with_a_covariance(walked):
    poses, odometry, _ = walked
    result = finish(odometry.map, odometry.views)
    off = inverse(poses[0]) @ poses
    distance = np.linalg.norm(result.T_map_head[:, :3, 3] - off[:, :3, 3], axis=1)
    assert distance.max() < 0.005
    std = np.sqrt(np.trace(result.covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (np.linalg.eigvalsh(result.covariance) > -1e-12).all()
    assert std[0] == 0.0
    assert 1e-5 < std[-1] < 0.01


def test_frames_depend_on_earlier_frames_alone(walked):
    poses, _, found = walked
    _, again = run(poses[:15])
    for a, b in zip(found, again, strict=False):
        assert np.array_equal(a.T_world_head, b.T_world_head)


def test_turning_on_the_spot_does_not_move_the_head():
    poses = walk(25, speed=0.0, turn=1.2)
    poses[:, :3, 3] = poses[0, :3, 3]
    _, found = run(poses)
    distance, angle = errors(poses, found)
    assert len(distance) == 25
    assert distance.max() < 0.005
    assert angle.max() < np.deg2rad(0.2)


def whirl(frames, fps=30.0):
    """T_world_head of a head that turns ever faster, up to 600 degrees a second, and back."""
    t = np.arange(frames) / fps
    rate = np.deg2rad(600.0) * np.sin(np.pi * t / t[-1]) ** 2
    yaw = np.cumsum(rate) / fps
    poses = walk(frames, turn=0.0)
    R = np.stack([exponential(np.array([0.0, 0.0, angle])) for angle in yaw])
    return rigid(R @ poses[:, :3, :3], poses[:, :3, 3])


def test_a_fast_turn_is_followed():
    poses = whirl(30)
    _, found = run(poses)
    assert [f.problem for f in found] == [""] * 30
    distance, angle = errors(poses, found)
    assert distance.max() < 0.01
    assert angle.max() < np.deg2rad(0.3)


def test_a_turned_picture_is_that_of_a_turned_head():
    views, T = Views.of(RIG, 320), walk(1)[0]
    turned = T @ rigid(exponential(np.array([0.1, -0.2, 0.3])), np.zeros(3))
    far = BoxWorld(scale=1e3)  # without parallax
    for v in range(2):
        expected = far.picture(RIG, v, turned).astype(float)
        made = views.turned(v, far.picture(RIG, v, T), T[:3, :3].T @ turned[:3, :3]).astype(float)
        both = (views.lens_masks[v] > 0) & (made > 0)
        assert both.mean() > 0.5
        assert np.median(np.abs(made - expected)[both]) < 2.0


@pytest.mark.parametrize("what", ["dark", "featureless", "noise"])
def test_pictures_without_features_have_no_pose(what):
    rng = np.random.default_rng(3)

    def emptied(i, pictures):
        if what == "dark":
            return tuple(rng.integers(0, 3, p.shape).astype(np.uint8) for p in pictures)
        if what == "featureless":
            return tuple(np.full_like(p, 140) for p in pictures)
        return tuple(rng.integers(0, 255, p.shape).astype(np.uint8) for p in pictures)

    _, found = run(walk(5), emptied)
    assert [f.T_world_head for f in found] == [None] * 5
    assert all(f.problem for f in found)


def test_a_covered_lens_is_a_gap_and_a_new_segment_follows():
    poses = walk(40)

    def covered(i, pictures):
        return tuple(np.full_like(p, 20) for p in pictures) if 10 <= i < 22 else pictures

    odometry, found = run(poses, covered)
    known = np.array([f.T_world_head is not None for f in found])
    assert known[:10].all()
    assert not known[10:22].any()
    assert known[24:].all()
    assert {f.segment for f in odometry.map.frames} == {0, 1}
    distance, _ = errors(poses, found, first=24)
    assert distance.max() < 0.01


def test_a_segment_that_cannot_begin_leaves_no_points():
    """Their patches would belong to a frame that is not in the map."""
    odometry = Odometry(Views.of(RIG, 320), replace(CONFIG, fewest=10_000))
    for i, pose in enumerate(walk(3)):
        assert odometry.add(i, i / 30.0, WORLD.pictures(RIG, pose)).problem
    assert len(odometry.map.points) == len(odometry.map.patches.host) == 0


def test_a_dropped_frame_is_bridged_within_the_same_map():
    poses = walk(25)
    odometry, found = run(poses, lambda i, p: (None, None) if i == 12 else p)
    assert found[12].T_world_head is None
    distance, _ = errors(poses, found)
    assert len(distance) == 24
    assert distance.max() < 0.01
    assert len({f.segment for f in odometry.map.frames}) == 1


def test_uneven_frames_are_followed():
    """As a live camera's, where frames are skipped while others are worked on."""
    poses, steps = walk(48), [1, 2, 5, 1, 4, 2, 6, 1, 3, 5, 2, 4, 6, 1, 3]
    chosen = np.cumsum([0, *steps])
    odometry = Odometry(Views.of(RIG, 320), CONFIG)
    found = [odometry.add(n, i / 30.0, WORLD.pictures(RIG, poses[i]))
             for n, i in enumerate(chosen)]  # fmt: skip
    assert [f.problem for f in found] == [""] * len(chosen)
    distance, _ = errors(poses[chosen], found)
    assert distance.max() < 0.01


def test_noisier_pictures_than_stated_are_followed():
    """Noise that all points share is learned from frame to frame."""
    rng = np.random.default_rng(5)
    poses = walk(30)

    def noisy(_, pictures):
        return tuple((p + rng.normal(0.0, 12.0, p.shape)).clip(0, 255).astype(np.uint8)
                     for p in pictures)  # fmt: skip

    odometry, found = run(poses, noisy, replace(CONFIG, noise_px=0.03))
    assert [f.problem for f in found] == [""] * 30
    assert 1.2 < odometry.noise < 2.5
    distance, _ = errors(poses, found)
    assert distance.max() < 0.03


def test_what_is_forgotten_changes_no_pose(walked):
    poses, whole, found = walked
    odometry = Odometry(Views.of(RIG, 320), CONFIG)
    odometry.forget()
    for i, T in enumerate(poses):
        again = odometry.add(i, i / 30.0, WORLD.pictures(RIG, T))
        assert np.array_equal(again.T_world_head, found[i].T_world_head)
        assert np.array_equal(again.covariance, found[i].covariance)
        if i % 5 == 4:
            odometry.forget()
    assert len(odometry.map.frames) < len(whole.map.frames)
    assert len(odometry.map.points) <= len(whole.map.points)
    assert odometry.map.patches.host.max() < len(odometry.map.frames)


def test_a_crowd_in_half_the_picture_does_not_move_the_head():
    poses = walk(25)
    other = BoxWorld(seed=9)
    moving = walk(25, speed=-2.0, turn=-1.0)

    def crowded(i, pictures):
        seen = other.pictures(RIG, moving[i])
        half = RIG.cameras[0].width // 2
        return tuple(
            np.hstack([p[:, :half], q[:, half:]]) for p, q in zip(pictures, seen, strict=True)
        )

    _, found = run(poses, crowded)
    known = [f for f in found if f.T_world_head is not None]
    if known:  # a gap is right, a wrong pose is not
        distance, _ = errors(poses, found)
        assert distance.max() < 0.05


def test_excluded_pixels_hold_no_points():
    odometry = Odometry(Views.of(RIG, 320), CONFIG)
    out = np.zeros((256, 320), bool)
    out[:, 160:] = True
    odometry.add(0, 0.0, WORLD.pictures(RIG, walk(1)[0]), (out, out))
    seen = odometry.map.frames[0].seen
    host = odometry.map.patches.view[seen.point] == seen.view
    assert host.any()
    assert (seen.pixel[host, 0] < 160).all()


def test_points_at_the_wearer_are_told_by_depth():
    points = np.array([[0.2, 0.1, -1.0], [0.3, 0.5, 0.0], [2.0, 0.0, -1.6], [0.1, 0.0, 2.0]])
    assert is_wearer(points).tolist() == [True, True, False, False]


def test_a_rig_of_one_view_has_no_scale():
    with pytest.raises(InputError, match="one view"):
        Views.of(replace(RIG, mounts=RIG.mounts[:1]), 320)
