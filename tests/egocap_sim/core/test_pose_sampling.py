"""Interpolated poses against motions with a closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from egocap.geometry import UP, axis_angle, quaternion_to_matrix, rigid, unit
from egocap_sim.core.pose_sampling import SampledPoses, between, slerp

RATE = 270.0
ACCELERATION = 100.0  # m/s^2


def swing(times: np.ndarray) -> np.ndarray:
    """One body on a circle of 0.5 m, at the speed that gives ACCELERATION."""
    angle = np.sqrt(ACCELERATION / 0.5) * times
    place = 0.5 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    return rigid(axis_angle(UP, angle), place)[:, None]


def test_between_samples_the_error_is_as_documented():
    samples = SampledPoses.from_transforms(swing(np.arange(400) / RATE), RATE)
    times = np.random.default_rng(0).uniform(0, 1.4, 500)
    found, true = samples.at(times), swing(times)
    error = np.linalg.norm(found[..., :3, 3] - true[..., :3, 3], axis=-1)
    assert error.max() < 0.0002
    assert np.abs(found[..., :3, :3] - true[..., :3, :3]).max() < 1e-9  # slerp is exact here


def test_samples_come_back_and_the_ends_hold(tmp_path):
    poses = swing(np.arange(20) / RATE)
    samples = SampledPoses.from_transforms(poses, RATE)
    assert np.allclose(samples.at(np.arange(20) / RATE), poses, atol=1e-12)
    assert np.allclose(samples.at(-1.0), poses[0]) and np.allclose(samples.at(9.0), poses[-1])
    samples.save(tmp_path / "poses")
    again = SampledPoses.load(tmp_path / "poses", RATE)
    assert np.array_equal(again.at(0.03), samples.at(0.03))


def test_single_bodies_at_their_own_times():
    poses = np.concatenate([swing(np.arange(50) / RATE), swing(np.arange(50) / RATE + 0.1)], 1)
    samples = SampledPoses.from_transforms(poses, RATE)
    times = np.array([[0.03, 0.11], [0.05, 0.02]])
    found = samples.at_bodies(times, np.array([1, 0]))
    for index in np.ndindex(2, 2):
        assert found[index] == pytest.approx(samples.at(times[index])[[1, 0][index[1]]])


def test_slerp_is_scipys_the_shorter_way_around():
    rng = np.random.default_rng(0)
    p, q = unit(rng.normal(size=(2, 50, 4)))
    q[0], q[1] = p[0], -p[1]
    share = rng.uniform(size=50)
    found = slerp(p, q, share)
    for a, b, s, r in zip(p, q, share, found, strict=True):
        ends = Rotation.from_quat([a, b], scalar_first=True)
        apart = Slerp([0.0, 1.0], ends)(s).inv() * Rotation.from_quat(r, scalar_first=True)
        assert apart.magnitude() < 1e-7
    a, b = (np.concatenate([rng.normal(size=(50, 3)), x], -1) for x in (p, q))
    T = between(a, b, share)
    np.testing.assert_allclose(T[:, :3, :3], quaternion_to_matrix(found), atol=1e-14)
    np.testing.assert_allclose(T[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (50, 1)))
