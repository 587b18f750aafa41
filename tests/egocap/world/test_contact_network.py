"""Contact features and the network: symmetry, frames of reference, gaps, files."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import MIRROR
from egocap.data.head_pose import HeadPoses
from egocap.errors import FileError
from egocap.geometry import inverse, rigid, transform
from egocap.world.contact_features import contact_features
from egocap.world.contact_network import (
    contact_probabilities,
    load_contact_network,
    save_contact_network,
)
from tests.egocap.evaluation.test_foot_contact import steps

LEFT, RIGHT = 13, 17  # feet among the labels


def walking(frames=90):
    """A body whose feet step in turn, its head poses, and which feet are planted."""
    feet, planted, times = steps(frames)
    rng = np.random.default_rng(0)
    body = 0.2 * rng.normal(size=(18, 3)) + [0.0, 0.0, 1.0]
    body[list(MIRROR)] = 0.5 * (body[list(MIRROR)] + body * [1.0, -1.0, 1.0])
    world = body + np.stack([1.2 * times / 2, 0 * times, 0 * times], -1)[:, None]
    for foot, joint, side in ((0, LEFT, 0.1), (1, RIGHT, -0.1)):
        world[:, joint] = feet[:, foot] + [0.0, side, 0.03]
        world[:, joint - 1] = world[:, joint] + [-0.15, 0.0, 0.05]
        world[:, joint - 2] = world[:, joint - 1] + [0.05, 0.0, 0.4]
    T = rigid(np.broadcast_to(np.eye(3), (frames, 3, 3)),
              np.stack([0.6 * times, 0 * times, 0 * times + 1.5], -1))  # fmt: skip
    return times, transform(inverse(T), world), np.full((frames, 18), 0.01), T, planted


def test_features_do_not_depend_on_the_worlds_place_and_heading():
    times, joints, sigma, T, _ = walking()
    moved = rigid(Rotation.from_euler("z", 2.0).as_matrix(), np.array([3.0, -4.0, 7.0])) @ T
    np.testing.assert_allclose(
        contact_features(times, joints, sigma, T), contact_features(times, joints, sigma, moved),
        atol=1e-9,
    )  # fmt: skip


def test_features_of_a_mirrored_motion_change_sides():
    times, joints, sigma, T, _ = walking()
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    mirrored = (joints * [1.0, -1.0, 1.0])[:, list(MIRROR)]
    there = contact_features(times, joints, sigma, T)
    back = contact_features(times, mirrored, sigma[:, list(MIRROR)], flip @ T @ flip)
    np.testing.assert_allclose(there, back[:, ::-1], atol=1e-9)


def test_steps_are_found_and_gaps_have_none():
    times, joints, sigma, T, planted = walking()
    known = np.ones(len(times), bool)
    found = contact_probabilities(times, joints, sigma, HeadPoses(T, known))
    either = found.reshape(-1, 2, 2).max(2) >= 0.5
    assert (either == planted).mean() > 0.8
    known[30:50] = False
    gap = contact_probabilities(times, joints, sigma, HeadPoses(T, known))
    assert not gap[30:50].any() and gap[:30].any()


def test_file_round_trip_and_bad_files(tmp_path):
    network, path = load_contact_network(), tmp_path / "n.npz"
    save_contact_network(network, path)
    again = load_contact_network(path)
    x = np.random.default_rng(0).normal(size=(3, len(network.mean)))
    np.testing.assert_allclose(again.probabilities(x), network.probabilities(x), atol=1e-3)
    arrays = {k: v for k, v in vars(network).items() if k != "b2"}
    np.savez(tmp_path / "bad.npz", **arrays)
    np.savez(tmp_path / "cut.npz", **(vars(network) | {"w2": network.w2[:-1]}))
    for name in ("bad.npz", "cut.npz"):
        with pytest.raises(FileError, match="not a contact network"):
            load_contact_network(tmp_path / name)
