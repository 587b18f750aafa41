"""Priors are learned from simulated motions and written where the caller asks."""

import pytest

from egocap.errors import InputError
from egocap.pose.motion_network import load_motion_network
from egocap.pose.motion_prior import load_motion_prior
from egocap_eval.priors import rendered, study, takes
from egocap_eval.priors.config import TrainingConfig


def test_priors_of_motion_are_learned_from_built_in_motions(monkeypatch, tmp_path):
    monkeypatch.setattr(study, "BUILT_IN", ("idle", "squat"))
    monkeypatch.setattr(takes, "SECONDS", 2.0)
    work = tmp_path / "work"
    outcome = study.study("motion", write=tmp_path / "prior.npz", work=work)
    assert [row["frames"] for row in outcome.result["clips"]] == [60, 60]
    assert max(row["fit_mm"] for row in outcome.result["clips"]) < 10.0
    assert load_motion_prior(tmp_path / "prior.npz") is not None
    settings = TrainingConfig(members=1, channels=4, steps=2, batch=2)
    monkeypatch.setattr(rendered, "RECORDINGS", (rendered.Recordings(("cap",), 330_000, 6),))
    for _ in range(2):  # the second time from the kept tracks
        study.study("network", write=tmp_path / "net.npz", work=work, draws=1, training=settings)
    assert load_motion_network(tmp_path / "net.npz").into.shape == (1, 152, 4)
    assert len(list((work / "takes").iterdir())) == 2
    assert len(list((work / "tracks").iterdir())) == 4


def test_pose_prior_requires_a_folder():
    with pytest.raises(InputError, match="folder"):
        study.study("pose")
