"""What the contact network is learned from."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.data.head_pose import HeadPoses
from egocap.data.truth import SELF_OCCLUDED, VISIBLE
from egocap_eval.world.learn_contacts import Example, _score, hide_legs, train

FRAMES = 90


def stepping(seed):
    """Feet that rest for 0.4 s and rise for 0.4 s in turn, at 30 frames a second."""
    rng = np.random.default_rng(seed)
    times = np.arange(FRAMES) / 30
    joints = 0.3 * rng.normal(size=(18, 3)) + 0.004 * rng.normal(size=(FRAMES, 18, 3))
    joints[:, :, 2] -= 1.0
    contact = np.zeros((FRAMES, 4), bool)
    for side, name in enumerate(("left", "right")):
        up = np.sin(2 * np.pi * times / 0.8 + np.pi * side)
        for part in ("foot", "ankle"):
            joints[:, LABEL_INDEX[f"{name}_{part}"], 2] = -1.6 + 0.15 * np.maximum(up, 0.0)
        contact[:, 2 * side : 2 * side + 2] = (up <= 0.0)[:, None]
    heads = HeadPoses(np.tile(np.eye(4), (FRAMES, 1, 1)), np.ones(FRAMES, bool))
    sigma = np.full((FRAMES, 18), 0.02)
    return Example("steps", times, (joints,), sigma, heads, contact, np.ones(FRAMES, bool))


def test_frames_whose_contacts_are_not_known_teach_nothing():
    whole = stepping(0)
    x, y = whole.samples()
    assert x.shape[0] == y.shape[0] == 2 * FRAMES and y.shape[1] == 2
    known = np.arange(FRAMES) >= 30
    fewer, labels = replace(whole, known=known, tracks=whole.tracks * 2).samples()
    assert len(fewer) == len(labels) == 2 * 2 * 60
    np.testing.assert_array_equal(fewer[:120], x[60:])
    np.testing.assert_array_equal(labels[120:], y[60:])


def test_a_network_learns_steps_of_others():
    pytest.importorskip("torch")
    network = train([stepping(seed).samples() for seed in range(12)], seed=1)
    (score,) = _score(network, [stepping(20), stepping(21)])
    assert score > 0.95


def test_lower_legs_are_hidden_for_long_stretches_and_nothing_else():
    @dataclass(frozen=True)
    class Seen:
        visibility: np.ndarray

    @dataclass(frozen=True)
    class Motion:
        truth: Seen

    motion = Motion(Seen(np.full((600, 2, 18), VISIBLE, np.uint8)))
    hidden = hide_legs(motion, np.random.default_rng(3)).truth.visibility
    legs = [LABEL_INDEX[f"{s}_{p}"] for s in ("left", "right") for p in ("knee", "ankle", "foot")]
    assert (np.delete(hidden, legs, axis=2) == VISIBLE).all()
    foot = hidden[:, 0, LABEL_INDEX["left_foot"]] == SELF_OCCLUDED
    assert 0.2 < foot.mean() < 0.8 and np.abs(np.diff(foot.astype(int))).sum() < 100
    np.testing.assert_array_equal(hidden[:, 0], hidden[:, 1])
