"""Priors are learned from simulated motions and written where the caller asks."""

import pytest

from egocap.errors import InputError
from egocap.pose.motion_prior import load_motion_prior
from egocap_eval.studies import learn_prior


def test_motion_prior_is_learned_from_built_in_motions(monkeypatch, tmp_path):
    monkeypatch.setattr(learn_prior, "BUILT_IN", ["idle", "squat"])
    monkeypatch.setattr(learn_prior, "SECONDS", 3.0)
    path = tmp_path / "prior.npz"
    outcome = learn_prior.study("motion", write=path)
    assert [row["frames"] for row in outcome.result["clips"]] == [90, 90]
    assert max(row["fit_mm"] for row in outcome.result["clips"]) < 10.0
    assert load_motion_prior(path) is not None


def test_pose_prior_requires_a_folder():
    with pytest.raises(InputError, match="folder"):
        learn_prior.study("pose")
