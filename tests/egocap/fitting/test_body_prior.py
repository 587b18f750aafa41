"""The prior over bodies: what its file says, and the scatter that it leaves everybody."""

import json

import numpy as np
import pytest

from egocap.errors import FileError
from egocap.fitting.body_prior import (
    COMPONENTS,
    INDIVIDUAL,
    BodyPrior,
    learn_shares,
    load_shares,
    save_shares,
)

AT = {name: i for i, name in enumerate(COMPONENTS)}


def test_learned_proportions_are_those_of_the_people(tmp_path):
    rng = np.random.default_rng(0)
    mixing = rng.normal(0.0, 0.01, (5, len(COMPONENTS)))
    people = load_shares().mean + rng.normal(size=(4000, 5)) @ mixing
    save_shares(learn_shares(people), len(people), tmp_path / "prior.json")
    again = load_shares(tmp_path / "prior.json")
    np.testing.assert_allclose(again.mean, people.mean(0), atol=1e-6)
    np.testing.assert_allclose(again.directions.T @ again.directions, np.cov(people.T), atol=1e-6)


def test_bones_of_one_stature_scatter_together_and_by_themselves():
    prior = BodyPrior.for_height(1.7)
    std = np.sqrt(np.diag(prior.individual))
    straight = [AT[kind, 2] for kind in ("elbow", "wrist", "hand", "knee", "ankle")]
    assert (std[straight] >= INDIVIDUAL * np.abs(prior.mean[straight]) - 1e-12).all()
    thigh, shin = AT["knee", 2], AT["ankle", 2]
    assert -0.8 < prior.individual[thigh, shin] / (std[thigh] * std[shin]) < -0.3
    alone = 1.0 / np.diag(np.linalg.inv(prior.individual))
    assert (alone[straight] >= (0.02 * prior.mean[straight]) ** 2).all()


def test_a_file_of_other_components_is_refused(tmp_path):
    path = tmp_path / "prior.json"
    save_shares(load_shares(), 9, path)
    data = json.loads(path.read_text())
    for key, value in (("components", data["components"][1:]),
                       ("directions_percent", [[1.0, 2.0]]),
                       ("mean_percent", data["mean_percent"][1:])):  # fmt: skip
        path.write_text(json.dumps(data | {key: value}))
        with pytest.raises(FileError, match="components"):
            load_shares(path)
