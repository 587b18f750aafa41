"""The study of rigs on heads: planted offsets, errors of a known pose, means and targets."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.cameras.rig_files import parse_rig
from egocap.fitting.body_prior import BodyPrior, to_proportions
from egocap.fitting.fit_rig import moved_rig
from egocap.geometry import exponential, rigid
from egocap_eval.studies.fit_rig import missed, planted, pose_errors, stance_error, summary, table

RIG = parse_rig(
    {"name": "r", "lens": {"model": "equidistant", "width": 640, "height": 512, "fov": 180},
     "stereo": {"baseline": 0.3, "forward": 0.3, "up": 0.1, "pitch": 85}}, "r",
)  # fmt: skip


def test_offsets_have_their_size():
    offset = planted(15.0, 4.0, np.random.default_rng(0))
    assert np.linalg.norm(offset[:3]) == pytest.approx(np.deg2rad(4.0))
    assert np.linalg.norm(offset[3:]) == pytest.approx(0.015)


def test_an_error_is_that_of_the_head_frame():
    offset = planted(6.0, 2.0, np.random.default_rng(1))
    std = np.repeat([np.deg2rad(1.0), 0.003], 3)
    fit = SimpleNamespace(rig=moved_rig(RIG, offset), std=std, covariance=np.diag(std**2))
    found = pose_errors(fit, RIG)
    assert found["position_mm"] == pytest.approx(6.0, abs=0.01)
    assert found["rotation_deg"] == pytest.approx(2.0, abs=0.01)
    assert found["mahalanobis_squared"] == pytest.approx(8.0, abs=0.01)


def test_means_and_targets():
    row = {"position_mm": 4.0, "rotation_deg": 1.5, "stance_deg": 1.2,
           "mahalanobis_squared": 6.0,
           "tracked_mm": {"known": 10.0, "fitted": 12.0, "given": 50.0}}  # fmt: skip
    means = summary({"a": row, "b": row | {"mahalanobis_squared": 18.0}})
    assert means["normalised_error"] == pytest.approx(2.0**0.5, abs=0.01)
    assert means["tracked_above_known_mm"] == 2.0
    assert missed(means) == ["rotation_deg 1.5, not 1"]
    assert "a" in table({"a": row}).text()


def test_the_error_of_the_stance_is_the_mean_attitude_of_the_head():
    """Half the stances look 4 degrees to the left, the others straight ahead: 2."""
    standing, turned = np.zeros((2, DOF_COUNT))
    turned[DOF_INDEX["neck_turn"]] = np.deg2rad(50.0)
    angles = np.repeat([standing, turned, standing], 20, axis=0)
    heads = np.tile(np.eye(4), (60, 1, 1))
    heads[40:] = rigid(exponential(np.deg2rad([0.0, 0.0, 4.0])), np.zeros(3))
    person = to_proportions(BodyPrior.for_height(1.75).mean)
    truth = SimpleNamespace(time=np.arange(60) / 20.0, joints_head=forward(person, angles),
                            T_world_head=heads)  # fmt: skip
    assert stance_error(truth, 60) == pytest.approx(2.0, abs=0.01)
