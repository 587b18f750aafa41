"""The motion network: its arithmetic against torch, frame rates, gaps, and its file."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from egocap.body.skeleton import DOF_INDEX
from egocap.data.head_pose import HeadPoses
from egocap.errors import FileError
from egocap.pose.motion_network import (
    DILATIONS,
    INPUTS,
    STEP_S,
    UNIT,
    MotionNetwork,
    correct_track,
    load_motion_network,
    network_inputs,
    save_motion_network,
)
from egocap.pose.pose_prior import load_posture, unlikeness
from egocap.series import interpolate
from egocap.track.tracker import Tracker


def made_up(members=2, channels=8, seed=0):
    rng = np.random.default_rng(seed)
    blocks = members, len(DILATIONS), 3, channels, channels

    def draw(*shape):
        return 0.1 * rng.standard_normal(shape).astype(np.float32)

    return MotionNetwork(
        draw(members, INPUTS, channels), draw(members, channels), draw(*blocks),
        draw(*blocks[:2], channels), draw(members, channels, 74), draw(members, 74),
        np.eye(37, dtype=np.float32),
    )  # fmt: skip


def by_torch(network, inputs):
    """Mean and standard deviation of every member, by torch's convolutions."""
    x = torch.from_numpy(inputs.T[None])
    for m in range(len(network.into)):
        hidden = F.conv1d(x, torch.from_numpy(network.into[m].T[..., None].copy()),
                          torch.from_numpy(network.into_bias[m]))  # fmt: skip
        for b, dilation in enumerate(DILATIONS):
            taps = torch.from_numpy(network.blocks[m, b].transpose(2, 1, 0).copy())
            bias = torch.from_numpy(network.block_biases[m, b])
            hidden = hidden + F.conv1d(
                F.silu(hidden), taps, bias, dilation=dilation, padding=dilation
            )
        out = F.conv1d(F.silu(hidden), torch.from_numpy(network.out[m].T[..., None].copy()),
                       torch.from_numpy(network.out_bias[m]))[0].T.numpy()  # fmt: skip
        yield out[:, :37], np.exp(np.clip(out[:, 37:], -3, 3))


def test_arithmetic_against_torch():
    network = made_up(members=3)
    inputs = np.random.default_rng(1).standard_normal((30, INPUTS)).astype(np.float32)
    mean, std = network(inputs)
    means, stds = map(np.array, zip(*by_torch(network, inputs), strict=True))
    assert np.allclose(mean, UNIT * means.mean(0), atol=1e-5)
    jackknife = 2 / 3 * np.sum((means - means.mean(0)) ** 2, axis=0)  # of three groups
    assert np.allclose(std, UNIT * np.sqrt(np.mean(stds**2, axis=0) + jackknife), rtol=1e-4)


def test_frame_rate_does_not_matter(motion):
    network, std = made_up(), np.full((len(motion.times), 18), 0.02)
    few = correct_track(
        motion.times[::2], motion.angles[::2], std[::2], motion.person, None, network
    )
    all_frames = correct_track(motion.times, motion.angles, std, motion.person, None, network)
    assert np.allclose(few[0][:-1], all_frames[0][:-2:2], atol=1e-3)
    assert np.allclose(few[1][:-1], all_frames[1][:-2:2], rtol=1e-3)


def test_deviations_grow_away_from_everyday_poses(motion):
    network, std = made_up(), np.full((len(motion.times), 18), 0.02)
    usual = np.tile(load_posture().mean, (len(motion.times), 1))
    unusual = usual.copy()
    unusual[30:] += 1.0  # rad, of every angle
    far = unlikeness(unusual[-1])
    assert unlikeness(usual[0]) == 0.0 and far > 4.0
    inputs = network_inputs(motion.times, unusual, std, motion.person, None)
    at = np.arange(motion.times[0], motion.times[-1] + 1e-9, STEP_S)
    _, stated = network(interpolate(at, motion.times, inputs).astype(np.float32))
    _, found = correct_track(motion.times, unusual, std, motion.person, None, network)
    assert np.allclose(found[0], stated[0], rtol=1e-4)
    last = np.searchsorted(motion.times, at[-1] - 1e-6)
    assert np.allclose(found[last], far * stated[-1], rtol=1e-3)


def test_stretches_apart_do_not_see_each_other(motion):
    network, std = made_up(), np.full((len(motion.times), 18), 0.02)
    times = motion.times + np.where(np.arange(len(motion.times)) < 40, 0.0, 1e4)
    both = correct_track(times, motion.angles, std, motion.person, None, network)
    first = correct_track(times[:40], motion.angles[:40], std[:40], motion.person, None, network)
    assert np.allclose(both[0][:40], first[0]) and np.allclose(both[1][:40], first[1])


def test_one_frame_and_gaps_of_the_head_pose(motion):
    network, std = load_motion_network(), np.full((len(motion.times), 18), 0.02)
    mean, spread = correct_track(
        motion.times[:1], motion.angles[:1], std[:1], motion.person, None, network
    )
    assert np.isfinite(mean).all() and (spread > 0).all()
    heads = HeadPoses(np.tile(np.eye(4), (len(std), 1, 1)), np.arange(len(std)) % 9 > 3)
    inputs = network_inputs(motion.times, motion.angles, std, motion.person, heads)
    assert np.array_equal(inputs[:, -1], heads.known) and not inputs[~heads.known, -43:].any()


def test_shipped_network_is_mirror_symmetric_on_average(motion):
    """It was learned from motions and their mirrors."""
    std = np.full((len(motion.times), 18), 0.02)
    mean, _ = correct_track(motion.times, motion.angles, std, motion.person, None)
    bend = [DOF_INDEX[f"{side}_knee_flexion"] for side in ("left", "right")]
    assert np.abs(np.diff((mean - motion.angles)[:, bend].mean(0))) < np.deg2rad(8)


def test_files(tmp_path):
    network = made_up()
    save_motion_network(network, tmp_path / "n.npz")
    back = load_motion_network(tmp_path / "n.npz")
    assert np.allclose(back.blocks, network.blocks, atol=1e-3)
    for change, message in (
        ({"out_bias": network.out_bias[:, :70]}, "angles"),
        ({"into": np.full_like(network.into, np.nan)}, "finite"),
        ({"into": np.float32(1.0)}, "skeleton"),
        ({"into": network.into[0]}, "for this"),
        ({"correlation": np.zeros(3, np.float32)}, "not for"),
        ({"correlation": -network.correlation}, "positive"),
    ):
        path = tmp_path / f"{message}.npz"
        save_motion_network(replace(network, **change), path)
        with pytest.raises(FileError, match=message):
            load_motion_network(path)
    (tmp_path / "x.npz").write_bytes(b"PK nonsense")
    with pytest.raises(FileError, match="motion network"):
        load_motion_network(tmp_path / "x.npz")


def test_any_frame_rate_and_gaps_in_the_tracker(motion):
    found = motion.detect("simulated:2", hidden=0.3)
    for step in (1 / 10, 1 / 60, 5.0):
        times = step * np.arange(len(found.times))
        times[50:] += 30.0
        result = Tracker(motion.rig, motion.person).track(replace(found, times=times))
        assert np.isfinite(result.joints_head).all() and np.isfinite(result.covariance).all()
        assert np.median(motion.errors(result)) < 0.03
