"""Online head poses on exact pictures of a box: placed in the world, lost, and found again."""

import time
from threading import Event

import numpy as np
import pytest

from egocap.head_pose import online, rig_correction
from egocap.head_pose.online import NO_WORLD, NOT_FITTING, OnlineHeadPose
from egocap.odometry.config import OdometryConfig
from egocap.odometry.self_calibration import PARAMETERS, corrected
from egocap.odometry.views import Views
from tests.egocap.odometry.box_world import BoxWorld, apart, small_rig, walk

RIG, WORLD, FPS = small_rig(), BoxWorld(), 12.0
CONFIG = OdometryConfig(width=320, corners=150)
POSES = walk(46, speed=0.6, turn=0.35, fps=FPS)
PICTURES = [[np.repeat(p[..., None], 3, axis=-1) for p in WORLD.pictures(RIG, T)] for T in POSES]
COVERED = range(30, 33)


def run(covered=range(0), rig=RIG):
    head = OnlineHeadPose(rig, CONFIG, waits=True)
    found = [head.step((None, None) if i in covered else PICTURES[i], i / FPS)
             for i in range(len(POSES))]  # fmt: skip
    facts = head.facts()
    head.close()
    return found, facts


@pytest.fixture(scope="module")
def walked():
    return run()


def test_the_head_is_placed_on_the_floor_once_two_searches_agree(walked):
    found, facts = walked
    first = next(i for i, T in enumerate(found) if T is not None)
    assert 2.0 <= first / FPS < 3.2
    assert all(T is not None for T in found[first:])
    assert facts["posed"] == len(POSES) - first and facts["without"] == {NO_WORLD: first}
    assert facts["vertical"]["up_from"] == "the floor" and facts["segments"] == 1
    T = np.stack(found[first:])
    assert np.abs(T[:, 2, 3] - POSES[first:, 2, 3]).max() < 0.02
    up = np.arccos(np.clip((T[:, 2, :3] * POSES[first:, 2, :3]).sum(1), -1.0, 1.0))
    assert np.degrees(up.max()) < 0.5
    moved = np.linalg.norm(T[:, :2, 3] - T[0, :2, 3], axis=1)
    true = np.linalg.norm(POSES[first:, :2, 3] - POSES[first, :2, 3], axis=1)
    assert np.abs(moved - true).max() < 0.015


def test_the_first_head_is_above_the_origin_and_faces_x(walked):
    found, _ = walked
    first = next(i for i, T in enumerate(found) if T is not None)
    yaw = np.arctan2(POSES[0, 1, 0], POSES[0, 0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    true = (POSES[first, :2, 3] - POSES[0, :2, 3]) @ [[c, -s], [s, c]]
    assert np.abs(found[first][:2, 3] - true).max() < 0.03


def test_the_same_pictures_give_the_same_poses(walked):
    for a, b in zip(walked[0], run()[0], strict=True):
        assert (a is None and b is None) or np.array_equal(a, b)


def test_a_short_gap_is_bridged_in_the_same_map(walked):
    found, facts = run(COVERED)
    known = [i for i, T in enumerate(found) if T is not None]
    assert set(COVERED).isdisjoint(known) and facts["segments"] == 1
    assert max(np.abs(found[i] - walked[0][i]).max() for i in known if i > COVERED[-1]) < 0.02


def test_after_a_long_gap_the_world_goes_on_from_the_last_place():
    """The map is given up; up and the floor are sought again, in which time there is no pose."""
    head = OnlineHeadPose(RIG, CONFIG, waits=True)
    found = [head.step(PICTURES[i], i / FPS) for i in range(40)]
    for i in range(40, 48):
        assert head.step((None, None), i / FPS) is None
    again = [head.step(PICTURES[i], (43 + i) / FPS) for i in range(5, 41)]  # from elsewhere
    head.close()
    known = [5 + i for i, T in enumerate(again) if T is not None]
    assert known and known[0] >= 5 + 2 * FPS and head.facts()["segments"] == 2
    last, first = found[-1], again[known[0] - 5]
    moved = np.linalg.norm(POSES[known[0], :2, 3] - POSES[5, :2, 3])
    assert abs(np.linalg.norm(first[:2, 3] - last[:2, 3]) - moved) < 0.03
    assert abs(first[2, 3] - POSES[known[0], 2, 3]) < 0.03


@pytest.fixture
def wrong_rig():
    """The rig with its right view turned by 0.6 degrees."""
    values = np.zeros((2, len(PARAMETERS)))
    values[1, :3] = np.deg2rad([0.4, -0.3, 0.3])
    return corrected(Views(RIG), values).rig


def test_a_wrong_rig_file_is_corrected_and_the_world_goes_on(monkeypatch, wrong_rig):
    """Corrected seven frames after the world is found; the next poses follow from the last."""
    monkeypatch.setattr(rig_correction, "KEYFRAMES", 10)
    found, facts = run(rig=wrong_rig)
    told = facts["self_calibration"]["right"]
    assert told["rotation_deg"] == pytest.approx(0.29, abs=0.03)  # half of it: the mean is kept
    known = [i for i, T in enumerate(found) if T is not None]
    assert known == list(range(known[0], len(POSES))) and facts["segments"] == 2
    off, _ = apart(POSES[known], np.stack([found[i] for i in known]))
    assert off.max() < 0.03


def test_the_correction_is_found_beside_the_pictures(monkeypatch, wrong_rig):
    monkeypatch.setattr(rig_correction, "KEYFRAMES", 8)
    head = OnlineHeadPose(wrong_rig, CONFIG)
    i, latest = 0, time.monotonic() + 120.0
    while not head.facts()["self_calibration"] and time.monotonic() < latest:
        head.step(PICTURES[min(i, len(POSES) - 1)], i / FPS)
        i += 1
    head.close()
    assert i > 8
    assert head.facts()["self_calibration"]["left"]["rotation_deg"] > 0.2


def test_a_run_ends_without_the_correction_that_is_under_way(monkeypatch):
    began, passed = Event(), []

    def slow(frames, *_):
        began.set()
        for _ in frames(False):
            passed.append(time.sleep(0.05))

    monkeypatch.setattr(rig_correction, "KEYFRAMES", 6)
    monkeypatch.setattr(rig_correction, "search_frames", slow)
    head = OnlineHeadPose(RIG, CONFIG)
    for i in range(len(POSES)):
        head.step(PICTURES[i], i / FPS)
        if began.is_set():
            break
    head.close()
    assert began.is_set() and len(passed) < 5


def test_there_is_no_world_while_pictures_do_not_fit_the_rig(monkeypatch):
    monkeypatch.setattr(rig_correction, "KEYFRAMES", 6)
    monkeypatch.setattr(online, "NOISY", 0.0)
    _, facts = run()
    assert 6 <= facts["without"][NOT_FITTING] <= 30 and facts["posed"] > 0


def test_a_rig_file_that_is_right_stays(monkeypatch, walked):
    monkeypatch.setattr(rig_correction, "KEYFRAMES", 10)
    found, facts = run()
    assert facts["self_calibration"] == {} and facts["segments"] == 1
    for a, b in zip(walked[0], found, strict=True):
        assert (a is None and b is None) or np.array_equal(a, b)


def test_memory_does_not_grow(monkeypatch, walked):
    monkeypatch.setattr(online, "_TIDY", 8)
    found, _ = run()
    for a, b in zip(walked[0], found, strict=True):
        assert (a is None and b is None) or np.allclose(a, b, atol=0.02)


def test_dark_pictures_have_no_pose_and_say_why():
    head = OnlineHeadPose(RIG, CONFIG, waits=True)
    dark = [np.zeros((256, 320, 3), np.uint8)] * 2
    assert [head.step(dark, i / FPS) for i in range(3)] == [None] * 3
    assert head.facts()["without"] == {"too few points with depth": 3}
    head.close()


def test_drawn_pictures_are_followed_exactly():
    """What the warm-up draws runs every kernel: points are found, followed and adjusted."""
    from egocap.geometry import rigid
    from egocap.odometry.odometry import Odometry

    views = Views.of(RIG, 320)
    odometry = Odometry(views, CONFIG)
    for i in range(3):
        T = rigid(np.eye(3), np.array([0.15 * i, 0.0, 0.0]))
        found = odometry.add(i, i / 30.0, online._drawn(views, T))
        assert np.abs(found.T_world_head - T).max() < 0.003
    assert len(odometry.map.keyframes) > 1
    OnlineHeadPose(RIG, CONFIG).warm_up()
