"""Training: the export computes what torch does, and a pattern that is there is learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX
from egocap.pose.motion_network import correct_track
from egocap.pose.pose_prior import load_posture
from egocap_eval.priors import training
from egocap_eval.priors.config import TrainingConfig
from egocap_eval.priors.tracks import LearningTrack
from egocap_eval.priors.training import (
    Network,
    export,
    make_example,
    subject_groups,
    train_network,
)

HIP, KNEE = DOF_INDEX["left_hip_flexion"], DOF_INDEX["left_knee_flexion"]


def swinging(seed):
    """A knee that follows its hip, tracked as if it were straight."""
    rng, t = np.random.default_rng(seed), np.arange(120) / 30.0
    truth = np.tile(load_posture().mean, (120, 1))
    swing = 0.4 * np.sin(2 * np.pi * rng.uniform(0.8, 1.2) * t + rng.uniform(0, 6))
    truth[:, HIP] += swing
    truth[:, KNEE] += swing
    tracked = truth.copy()
    tracked[:, KNEE] = load_posture().mean[KNEE]
    place = np.tile(np.eye(4), (120, 1, 1))
    offsets = np.asarray(Proportions.from_lengths(1.75).offsets)
    return LearningTrack(f"t{seed}", tracked, np.full((120, 18), 0.02), truth, place, offsets)


@pytest.fixture(scope="module")
def tracks():
    return [swinging(seed) for seed in range(6)]


def test_export_computes_what_torch_does(tracks):
    torch.manual_seed(0)
    network = Network(8, 0.3).eval()
    torch.nn.init.normal_(network.out.weight, std=0.1)
    example = make_example(tracks[0])
    with torch.no_grad():
        mean, log_std = network(torch.from_numpy(example.inputs.T[None]))
    found = export([network], [example])
    ours, std = found(example.inputs)
    assert np.allclose(ours, np.deg2rad(10) * mean[0].T.numpy(), atol=1e-5)
    assert np.allclose(std, np.deg2rad(10) * np.exp(log_std[0].T.numpy()), rtol=1e-4)
    assert np.linalg.eigvalsh(found.correlation)[0] > 0


def test_each_member_is_trained_without_a_group(tracks, monkeypatch):
    seen = []

    def fit(network, examples, config, rng):
        seen.append([e.correction.sum() for e in examples])
        yield from ()

    monkeypatch.setattr(training, "_fit", fit)
    monkeypatch.setattr(training, "export", lambda *_: None)
    people = [replace(t, name=n) for t, n in zip(tracks[:3], "abc", strict=True)]
    train_network(people, TrainingConfig(members=3, channels=4))
    whole = set(np.concatenate(seen))
    assert len(whole) == 6 and [len(s) for s in seen] == [4] * 3  # each with its mirror image
    assert set.union(*(whole - set(s) for s in seen)) == whole
    train_network(people, TrainingConfig(members=1, channels=4))
    assert set(seen[-1]) == whole


def test_groups_keep_subjects_together():
    names = ["training-cmu_14_07", "training-005_02", "builtin-walk-0", "training-cmu_14_21",
             "builtin-sit-1", "training-005_11", "training-cmu_13_01", "walk"]  # fmt: skip
    group = subject_groups(names, 3)
    assert group[0] == group[3] and group[1] == group[5] and group[2] == group[4]
    assert sorted(np.bincount(group)) == [2, 3, 3]
    assert subject_groups(names, 1) == [0] * len(names)
    assert len(set(subject_groups(["a_1", "a_2"], 3))) == 1


def test_what_is_there_is_learned(tracks):
    config = TrainingConfig(
        members=1, channels=16, steps=120, batch=8, dropout=0.0, noise=0.02, learning_rate=0.02
    )
    network = train_network(tracks, config)
    new = swinging(99)
    mean, _ = correct_track(new.times, new.angles, new.std, new.person, None, network)
    before, after = (np.abs(a - new.truth)[:, KNEE].mean() for a in (new.angles, mean))
    assert after < 0.6 * before
    again = train_network(tracks[:2], TrainingConfig(members=1, channels=8, steps=3, batch=4))
    same = train_network(tracks[:2], TrainingConfig(members=1, channels=8, steps=3, batch=4))
    assert np.array_equal(again.out, same.out)
