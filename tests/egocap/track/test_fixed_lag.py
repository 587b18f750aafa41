"""Fixed lag: what is marginalised is not lost, the future is not used, lost limbs come back."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.data.head_pose import HeadPoses
from egocap.errors import InputError
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import make_model
from egocap.pose.motion_prior import NO_MOTION_PREDICTION
from egocap.pose.observations import joined, observe
from egocap.track.fixed_lag import FixedLagSmoother, marginalise, smooth_fixed_lag
from egocap.track.online import OnlineTracker
from egocap.track.smoother import interval_system
from egocap.track.tracker import Tracker
from tests.egocap.conftest import make_motion

CONFIG = TrackerConfig(smoothing="fixed-lag")


def setup(motion, source, config=CONFIG, **kwargs):
    seen = observe(motion.detect(source, **kwargs), motion.rig, motion.person, config)
    return seen, make_model(motion.person, config)


def track(motion, source, config=CONFIG, **kwargs):
    seen, model = setup(motion, source, config, **kwargs)
    return smooth_fixed_lag(seen, motion.person, model, config)


def smoother_after(motion, source, frames):
    seen, model = setup(motion, source)
    smoother = FixedLagSmoother(motion.person, model, CONFIG)
    for t in range(frames):
        smoother.step(seen[t : t + 1])
    return smoother


def errors(motion, poses):
    joints = forward(motion.person, np.array([pose.angles for pose in poses]))
    return np.linalg.norm(joints - motion.joints, axis=-1)[:, 1:].mean(1)


def dense(bands):
    size = bands.shape[1]
    H = np.zeros((size, size))
    for k, diagonal in enumerate(bands):
        at = np.arange(size - k)
        H[at + k, at] = H[at, at + k] = diagonal[: size - k]
    return H


def test_marginalised_frames_say_the_same_as_the_frames_themselves(motion):
    """A Gauss-Newton step of six frames, against one of three with the others marginalised."""
    seen, model = setup(motion, "simulated:2", hidden=0.2)
    seen, angles = seen[10:16], motion.angles[10:16] + 0.05
    _, bands, gradient = interval_system(angles, seen, model, CONFIG)
    whole = np.linalg.solve(dense(bands), -gradient)
    covariance = np.linalg.inv(dense(bands))
    past = None
    for first in range(3):
        three = slice(first, first + 3)
        past = marginalise(past, angles[three], seen[three], model, CONFIG)
    _, bands, gradient = interval_system(angles[3:], seen[3:], model, CONFIG)
    energies = [past.add(angles[3:], bands, gradient)]
    n = 3 * DOF_COUNT
    np.testing.assert_allclose(np.linalg.solve(dense(bands), -gradient), whole[n:], atol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(dense(bands)), covariance[n:, n:], atol=1e-9)
    for sign in (-1, 1):  # the energy against its gradient, which is linear away from the mean
        moved = angles[3:] + sign * 1e-4
        energies.append(past.add(moved, np.zeros_like(bands), np.zeros(n)))
    slope = np.zeros(n)
    past.add(angles[3:], np.zeros_like(bands), slope)
    assert (energies[2] - energies[1]) / 2e-4 == pytest.approx(slope.sum(), rel=1e-6)


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_a_pose_depends_on_frames_up_to_the_lag_alone(motion, lag):
    config = replace(CONFIG, lag=lag)
    seen, model = setup(motion, "simulated:2", config)
    whole = smooth_fixed_lag(seen[:40], motion.person, model, config)
    seen.weights[30:] = 0
    cut = smooth_fixed_lag(seen[:40], motion.person, model, config)
    late = 30 - round(30 * lag)
    for t in range(40):
        same = np.array_equal(whole[t].angles, cut[t].angles)
        assert same == (t < late), t
    assert [pose.time for pose in whole] == list(motion.times[:40])


def test_a_lag_lowers_the_error_and_keeps_the_covariance():
    motion = make_motion(60, seed=1)
    found = [track(motion, "simulated:4", replace(CONFIG, lag=lag), hidden=0.3)
             for lag in (0.0, 0.1)]  # fmt: skip
    now, late = (errors(motion, poses)[10:].mean() for poses in found)
    assert late < 0.95 * now < 0.03
    for early, later in zip(*found, strict=True):
        np.testing.assert_allclose(later.covariance, early.covariance, rtol=1e-6, atol=1e-9)
        assert np.linalg.eigvalsh(later.covariance)[0] > 0.0


def test_better_than_the_causal_filter():
    motion = make_motion(60, seed=2)
    found = motion.detect("simulated:3,outliers=0.05", hidden=0.3)
    now, before = (
        motion.errors(Tracker(motion.rig, motion.person, config).track(found))[10:].mean()
        for config in (CONFIG, TrackerConfig(smoothing="none"))
    )
    assert now < 0.9 * before


def test_recovers_within_a_third_of_a_second_after_two_seconds_without_detections():
    motion = make_motion(120, seed=4)
    seen, model = setup(motion, "simulated:2")
    seen.weights[30:90] = 0
    poses = smooth_fixed_lag(seen, motion.person, model, CONFIG)
    off = errors(motion, poses)
    held = np.array([pose.angles for pose in poses])[60:90]
    assert np.isfinite(off).all() and np.ptp(held, axis=0).max() < 0.1  # at rest in the dark
    assert (off[99:] < 1.5 * np.median(off[10:30])).all()


def test_a_lost_window_starts_again_from_the_filter_and_a_good_one_stays():
    motion = make_motion(20, seed=6)
    smoother = smoother_after(motion, "simulated:2", 20)
    window = joined([frame.chosen for frame in smoother._window])
    good = np.array([frame.angles for frame in smoother._window])

    def restarted(angles):
        found = smoother._minimised(angles, window, 0, NO_MOTION_PREDICTION, smoother._past)
        return smoother._restarted(found, window, NO_MOTION_PREDICTION)[0].states

    assert restarted(good) is good
    lost = good + np.where(np.arange(DOF_COUNT) == DOF_INDEX["left_shoulder_raise"], 1.5, 0.0)
    found = restarted(lost)
    joints = forward(motion.person, np.stack([found, lost, motion.angles[-len(found) :]]))
    off = np.linalg.norm(joints[:2] - joints[2], axis=-1)[..., LABEL_INDEX["left_hand"]].mean(1)
    assert off[0] < 0.02 < 0.1 < off[1]


@pytest.mark.parametrize("seed", [10, 14, 15])
def test_a_forearm_that_points_along_a_ray_the_wrong_way_turns_round(seed):
    """One view's ray meets the wrist's sphere about the elbow twice; the other view tells which."""
    motion, until = make_motion(40, seed=seed), 20
    elbow, wrist, hand = (LABEL_INDEX[f"right_{part}"] for part in ("elbow", "wrist", "hand"))
    eye = motion.rig.mounts[1].T_head_camera[:3, 3]
    ray = motion.joints[:, wrist] - eye
    near = np.linalg.norm(ray, axis=1, keepdims=True)
    ray = ray / near
    off = motion.joints[:, elbow] - eye
    other = eye + (2.0 * np.sum(ray * off, 1, keepdims=True) - near) * ray
    found = motion.detect("simulated:1")
    shown, _ = motion.rig.project(other[:until])
    found.points[:until, :, wrist] = np.moveaxis(shown, 0, 1)
    found.valid[:, :, hand] = False
    seen = observe(found, motion.rig, motion.person, CONFIG)
    model = make_model(motion.person, CONFIG)
    poses = smooth_fixed_lag(seen, motion.person, model, CONFIG)
    joints = forward(motion.person, np.array([pose.angles for pose in poses]))[:, wrist]
    wrong = np.linalg.norm(joints - motion.joints[:, wrist], axis=-1)
    assert wrong[until] > 0.15
    assert wrong[until + 9 :].max() < 0.03


def test_a_new_frame_starts_where_the_motion_leads():
    motion = make_motion(20, seed=7)
    smoother = smoother_after(motion, "simulated:0", 19)
    last = smoother._window[-1].angles
    ahead = smoother._extrapolate(motion.times[19])
    joints = forward(motion.person, np.stack([ahead, last, motion.angles[19]]))
    off = np.linalg.norm(joints[:2] - joints[2], axis=-1).mean(1)
    assert off[0] < 0.6 * off[1]
    assert smoother._extrapolate(motion.times[19] + 1.0) is last  # after a gap


def test_the_online_tracker_gives_every_frame_once_and_late_by_the_lag():
    motion = make_motion(20)
    found = motion.detect("simulated:2")
    config = replace(CONFIG, lag=0.1)
    tracker = OnlineTracker(motion.rig, motion.person, config)
    given = [tracker.step(found[t : t + 1]) for t in range(20)]
    assert [len(poses) for poses in given] == [0] * 3 + [1] * 17
    poses = [pose for poses in given for pose in poses]
    assert [pose.time for pose in poses] == list(found.times[:17])
    rest = tracker.finish()
    assert [pose.time for pose in rest] == list(found.times[17:])
    assert tracker.finish() == []
    batch = Tracker(motion.rig, motion.person, config).track(found)
    np.testing.assert_allclose([p.angles for p in (*poses, *rest)], batch.angles, atol=1e-9)
    np.testing.assert_allclose(
        [p.covariance for p in (*poses, *rest)], batch.covariance, atol=1e-12
    )


def test_head_poses_inform_the_motion_prior_and_come_with_their_frames():
    motion = make_motion(20)
    found = motion.detect("simulated:4", hidden=0.3)
    config = replace(CONFIG, lag=0.1)
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, 2, 3], T[:, 0, 3] = 1.6, np.linspace(0.0, 0.9, 20)
    given = [None, None, *T[2:]]
    tracker = OnlineTracker(motion.rig, motion.person, config)
    poses = [p for t in range(20) for p in tracker.step(found[t : t + 1], given[t])]
    poses += tracker.finish()
    for pose, head in zip(poses, given, strict=True):
        assert pose.T_world_head is head
    heads = HeadPoses(T, np.arange(20) > 1)
    whole = Tracker(motion.rig, motion.person, config)
    batch = whole.track(found, None, heads)
    np.testing.assert_allclose([p.angles for p in poses], batch.angles, atol=1e-9)
    assert np.abs(batch.angles - whole.track(found).angles).max() > 0.01


def test_the_lag_stays_and_no_frame_is_lost_where_the_rate_falls():
    """From 30 to 10 frames a second with a lag of 0.1 s."""
    motion = make_motion(40)
    seen, model = setup(motion, "simulated:2")
    smoother = FixedLagSmoother(motion.person, model, replace(CONFIG, lag=0.1))
    chosen = [*range(15), *range(17, 40, 3)]
    lags, given = [], []
    for t in chosen:
        poses = smoother.step(seen[t : t + 1])
        given += [pose.time for pose in poses]
        lags += [motion.times[t] - pose.time for pose in poses[-1:]]
    assert np.allclose(lags, 0.1, atol=1e-6)
    given += [pose.time for pose in smoother.finish()]
    assert given == list(motion.times[chosen])


def test_every_frame_is_tracked_where_the_lag_lies_between_frames():
    """At 15 frames a second, 0.1 s is one and a half frames, and clocks jitter."""
    motion = make_motion(24)
    found = motion.detect("simulated:2")
    times = np.arange(24) / 15.0 + np.random.default_rng(0).uniform(0.0, 1e-3, 24)
    track = Tracker(motion.rig, motion.person, replace(CONFIG, lag=0.1)).track(
        replace(found, times=times)
    )
    assert np.array_equal(track.times, times)
    assert len(track.angles) == len(times)


def test_wrong_lags_are_refused():
    with pytest.raises(InputError, match="fixed-lag"):
        TrackerConfig(lag=0.1)
    for lag in (-0.1, 2.5, float("nan")):
        with pytest.raises(InputError, match="lag"):
            TrackerConfig(smoothing="fixed-lag", lag=lag)
