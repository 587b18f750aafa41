"""The command, from footage to weights that are kept or not."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

import egocap
from egocap.adaptation import adapt as module
from egocap.adaptation import footage as footage_module
from egocap.adaptation.adapt import adapt
from egocap.adaptation.config import AdaptOptions
from egocap.adaptation.footage import FEWEST, GAP_S, Recording, stretches, track_footage
from egocap.adaptation.labels import Labels, tracked_labels
from egocap.cli import main
from egocap.data.detections import save_detections
from egocap.data.sequence import open_sequence
from egocap.data.track import save_track
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.detect.train.examples import HIDDEN, OUTSIDE, SEEN
from egocap.detect.weights import open_weights
from egocap.errors import InputError


@pytest.fixture
def known(tiny_sequence, monkeypatch, empty_cache):
    """The true labels of seven frames, in place of a track's; every frame is a stretch."""
    sequence = open_sequence(tiny_sequence)
    truth = sequence.truth
    points = np.moveaxis(sequence.rig.project(truth.joints_head)[0], 0, 1)
    state = np.where(truth.visibility == VISIBLE, SEEN, HIDDEN)
    state = np.where(truth.visibility == OUT_OF_VIEW, OUTSIDE, state).astype(np.uint8)
    labels = Labels(points, state, np.zeros(state.shape, bool))
    monkeypatch.setattr(module, "track_footage", lambda *_: Recording(sequence, labels))
    monkeypatch.setattr("egocap.adaptation.footage._HELD_OUT", 3)
    monkeypatch.setattr("egocap.adaptation.footage.stretches",
                        lambda times: [range(i, i + 1) for i in range(len(times))])  # fmt: skip
    return tiny_sequence


def test_weights_that_fit_the_footage_better_are_kept(known, tiny_file, tmp_path):
    options = AdaptOptions(steps=25, weights=tiny_file, learning_rate=3e-3)
    result = adapt([known], tmp_path, options)
    assert result.kept and result.gain > result.gain_error
    adapted, start = open_weights(result.weights), open_weights(tiny_file)
    assert adapted.training["adapted_from"]["sha256"] == start.sha256
    assert adapted.calibration == start.calibration
    report = json.loads((tmp_path / "adapt.json").read_text())
    assert report["kept"] and report["auc_after"] > report["auc_before"]
    assert report["images"] == 10 and report["steps"] == 25 and report["stretches"] == 2


def test_the_result_is_the_mean_of_the_weights_before_and_after(tiny_file):
    start, trained = (open_weights(tiny_file).network() for _ in range(2))
    with torch.no_grad():
        trained.heat.weight += 2.0
    mean = module._mean(start, trained)
    torch.testing.assert_close(mean.heat.weight, start.heat.weight + 1.0)
    torch.testing.assert_close(trained.heat.weight, start.heat.weight + 2.0)
    assert mean.state_dict().keys() == start.state_dict().keys()


def test_other_labels_are_another_training(known, tiny_file, tmp_path, monkeypatch):
    options = AdaptOptions(steps=1, weights=tiny_file)
    adapt([known], tmp_path, options)
    recording = module.track_footage()
    moved = replace(recording.labels, points=recording.labels.points + 1.0)
    monkeypatch.setattr(module, "track_footage", lambda *_: replace(recording, labels=moved))
    adapt([known], tmp_path, options)
    assert len(list(tmp_path.glob("run-*"))) == 2


def test_weights_that_are_not_better_are_not_kept(known, tiny_file, tmp_path, monkeypatch, capsys):
    (tmp_path / "detector.safetensors").write_bytes(b"of an earlier run")
    words = ["egocap", "adapt", known, "--out", tmp_path, "--weights", tiny_file, "--steps", 1]
    monkeypatch.setattr("sys.argv", [*map(str, words), "--learning-rate", "1e-12", "--json"])
    assert main() == 0
    assert json.loads(capsys.readouterr().out)["kept"] is False
    assert not (tmp_path / "detector.safetensors").exists()


def test_an_interrupted_run_goes_on(known, tiny_file, tmp_path, monkeypatch):
    options = AdaptOptions(steps=4, weights=tiny_file)
    from egocap.detect.train.trainer import Trainer

    step = Trainer._step

    def interrupted(self, batch):
        if self.state.step == 1:
            import os
            import signal

            os.kill(os.getpid(), signal.SIGTERM)
        return step(self, batch)

    monkeypatch.setattr(Trainer, "_step", interrupted)
    assert adapt([known], tmp_path, options) is None
    assert not (tmp_path / "adapt.json").exists()
    monkeypatch.setattr(Trainer, "_step", step)
    assert adapt([known], tmp_path, options).steps == 4


def test_stretches_have_gaps_and_cover_the_footage():
    times = np.arange(0.0, 60.0, 1 / 30)
    found = stretches(times)
    assert len(found) == 15
    for before, after in pairwise(found):
        assert times[after.start] - times[before.stop - 1] == pytest.approx(GAP_S, abs=0.04)
    assert sum(map(len, found)) > 0.9 * len(times)
    assert len(stretches(times[:330])) == FEWEST


def test_short_footage_and_contradictory_options_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"9\.0 s.*10 s or more"):
        stretches(np.arange(0.0, 9.01, 0.1))
    with pytest.raises(InputError, match="no footage"):
        adapt([], tmp_path)
    with pytest.raises(InputError, match="--height and --body"):
        AdaptOptions(height=1.7, body="average:1.7")


def test_a_folder_of_mocap_is_not_tracked_again(tiny_sequence, tmp_path, monkeypatch):
    sequence = open_sequence(tiny_sequence)
    found = egocap.synthetic_detections(sequence)
    track = egocap.Tracker(sequence.rig, sequence.body).track(found)
    (tmp_path / "sequence").symlink_to(tiny_sequence)
    save_detections(tmp_path / "detections.npz", found)
    save_track(tmp_path / "track.npz", track)
    monkeypatch.setattr("egocap.adaptation.footage.steps", None)
    recording = track_footage(tmp_path, tmp_path / "work", AdaptOptions(), lambda *_: None)
    assert np.array_equal(recording.labels.state, tracked_labels(track, found, sequence.rig).state)
    assert not (tmp_path / "work").exists()


def test_a_sequence_is_detected_and_tracked(tiny_sequence, tmp_path):
    options = AdaptOptions(body="average:1.79")
    recording = track_footage(tiny_sequence, tmp_path, options, lambda *_: lambda _: None)
    assert recording.labels.state.shape == (7, 2, 18) and recording.labels.known.mean() > 0.3
    assert {"detections.npz", "track.npz"} <= {path.name for path in tmp_path.iterdir()}


def test_a_track_that_a_wrong_rig_biases_teaches_nothing(
    tiny_sequence, tmp_path, monkeypatch, empty_cache, tiny_file
):
    told = "the views are rotated by about 4 degrees against the rig file"
    monkeypatch.setattr(footage_module, "warning_of", lambda track, of: told)
    options = AdaptOptions(weights=tiny_file, body="average:1.79")
    with pytest.raises(InputError, match=f"{told}.*calibrated"):
        track_footage(tiny_sequence, tmp_path, options, lambda *_: lambda _: None)
