"""The body prior is learned from simulated people, and others are as it says."""

import numpy as np

from egocap.fitting.body_prior import COMPONENTS, BodyPrior, load_shares
from egocap_eval.priors import study
from egocap_eval.priors.bodies import BODIES, proportions_of


def test_other_people_are_as_the_prior_says():
    prior = BodyPrior.for_height(1.7)
    away = 1.7 * proportions_of(range(BODIES.stop, BODIES.stop + 20)) - prior.mean
    whitened = away @ np.linalg.inv(np.linalg.cholesky(prior.individual)).T
    assert 0.3 < (whitened**2).mean() < 1.2


def test_the_prior_of_bodies_requires_no_clips(monkeypatch, tmp_path):
    monkeypatch.setattr(study, "BODIES", range(BODIES.start, BODIES.start + 15))
    outcome = study.study("body", write=tmp_path / "prior.json")
    learned = load_shares(tmp_path / "prior.json")
    assert np.abs(learned.mean - load_shares().mean).max() < 0.01
    rows = {row["component"]: row for row in outcome.result["components"]}
    thigh = float(learned.mean[COMPONENTS.index(("knee", 2))])
    assert rows["knee z"]["mean_percent"] == round(100.0 * thigh, 3)
