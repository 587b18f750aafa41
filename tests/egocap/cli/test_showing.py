"""egocap posterior as a user runs it, on the learned detector's detections."""

import json
import sys

from egocap import cli
from egocap.body.proportions import Proportions
from egocap.data.sequence import Sequence
from egocap.posterior.detector_error import load_detector_error
from egocap.posterior.result import load_posterior


def test_posterior_of_learned_detections_with_another_body(
    tiny_sequence, tmp_path, monkeypatch, capsys
):
    tall = Proportions(1.1 * Sequence(tiny_sequence).body.offsets)
    tall.save(tmp_path / "body.json")
    words = ["posterior", tiny_sequence, "--frame", 2, "--out", tmp_path / "p.npz", "--body",
             tmp_path / "body.json", "--most-steps", 500, "--json"]  # fmt: skip
    monkeypatch.setattr(sys, "argv", ["egocap", *map(str, words)])
    assert cli.main() == 0
    out, err = capsys.readouterr()
    summary, found = json.loads(out), load_posterior(tmp_path / "p.npz")
    assert summary["converged"] == found.converged == (summary["largest_rhat"] <= 1.01)
    assert summary["least_effective"] > 0 and "steps" in err
    model = load_detector_error()
    assert found.config["detections"] == model.detector
    assert found.config["posterior"]["temperature"] == model.temperature
    arm = found.flat_joints[:, 3] - found.flat_joints[:, 4]
    lengths = (arm**2).sum(axis=1) ** 0.5
    assert abs(lengths - tall.bone_lengths["left_wrist"]).max() < 1e-9
