"""The learned posture prior: learning with a known answer, the file, and its defects."""

import numpy as np
import pytest

from egocap.body.skeleton import DOF_INDEX, LIMITS, MIRROR_DOFS, MIRROR_SIGNS
from egocap.errors import FileError
from egocap.pose.pose_prior import FILE, FLOOR, learn_posture, load_posture, save_posture
from tests.egocap.conftest import rewritten


def test_learns_a_known_gaussian():
    rng = np.random.default_rng(0)
    motions = [np.outer(rng.normal(size=60), np.ones(37)) for _ in range(200)]
    mean, covariance = learn_posture(motions)
    left, right = DOF_INDEX["left_hip_flexion"], DOF_INDEX["right_knee_flexion"]
    assert covariance[left, right] == pytest.approx(1.0, rel=0.05)
    assert covariance[left, left] == pytest.approx(1.0 + FLOOR**2, rel=0.05)
    assert np.allclose(mean, mean[list(MIRROR_DOFS)] * MIRROR_SIGNS)


def test_round_trip(tmp_path):
    mean, covariance = learn_posture([np.random.default_rng(1).normal(size=(50, 37))])
    save_posture(mean, covariance, tmp_path / "p.json")
    again = load_posture(tmp_path / "p.json")
    assert np.allclose(again.mean, mean, atol=1e-4)
    assert np.allclose(np.linalg.inv(again.precision), covariance, atol=1e-4)


def test_the_one_in_use_is_sane_and_symmetric():
    posture = load_posture()
    assert (posture.mean > LIMITS[:, 0]).all() and (posture.mean < LIMITS[:, 1]).all()
    assert np.linalg.eigvalsh(posture.precision)[0] > 0
    flip = np.eye(37)[list(MIRROR_DOFS)] * MIRROR_SIGNS[:, None]
    assert np.allclose(flip @ posture.precision @ flip.T, posture.precision, rtol=1e-2, atol=0.5)
    assert np.allclose(flip @ posture.mean, posture.mean, atol=1e-4)
    covariance = np.linalg.inv(posture.precision)
    hip, knee = DOF_INDEX["left_hip_flexion"], DOF_INDEX["left_knee_flexion"]
    assert covariance[hip, knee] > 0.3 * np.sqrt(covariance[hip, hip] * covariance[knee, knee])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop("mean_deg"), "mean_deg"),
        (lambda d: d["mean_deg"].pop(), "angles"),
        (lambda d: d["dofs"].reverse(), "angles"),
        (lambda d: d["covariance_deg2"][3].pop(), "angles"),
        (lambda d: d["covariance_deg2"][0].__setitem__(0, -1.0), "positive definite"),
    ],
)
def test_bad_files_are_named(tmp_path, change, says):
    with pytest.raises(FileError, match=says):
        load_posture(rewritten(FILE, change, tmp_path / "p.json"))
