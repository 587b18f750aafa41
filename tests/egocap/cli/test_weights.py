"""Weights describe themselves."""

import json

import pytest

from egocap.cli import main
from egocap.detect.weights import open_weights


def output(monkeypatch, capsys, *words):
    monkeypatch.setattr("sys.argv", ["egocap", "weights", *map(str, words)])
    assert main() == 0
    return capsys.readouterr().out


def test_shipped_weights_are_listed(monkeypatch, capsys):
    assert open_weights().name in output(monkeypatch, capsys, "list").splitlines()[0]
    (first, *_) = json.loads(output(monkeypatch, capsys, "list", "--json"))
    assert first["sha256"] == open_weights().sha256
    assert 1e6 < first["parameters"] < 2.5e7
    assert first["stages"][0]["command"].startswith("egocap train")


def test_every_stage_of_the_training_is_shown(tiny_file, tmp_path, monkeypatch, capsys):
    from egocap.detect.weights import load_weights, save_weights

    stages = {"command": "second", "steps": 7, "seconds": 120.0, "scores": {"pck": 91.234},
              "start": {"name": "tiny-1", "training": {"command": "first"}}}  # fmt: skip
    save_weights(tmp_path / "mine.safetensors", load_weights(tiny_file), stages)
    lines = output(monkeypatch, capsys, "show", tmp_path / "mine.safetensors").splitlines()
    assert lines[2:] == [
        "on sequences held out from its training: pck 91.2",
        "trained: second", "  7 steps, 2 min", "trained: first",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("training", "key"),
    [
        ({"scores": [1, 2]}, "training.scores"),
        ({"scores": {"pck": "high"}}, "training.scores.pck"),
        ({"seconds": "long"}, "training.seconds"),
        ({"steps": None, "command": 3}, "training.command"),
        ({"averaged_with": "tiny"}, "training.averaged_with"),
        ({"start": {"name": "a", "training": {"steps": []}}}, "training.start.training.steps"),
    ],
)
def test_a_damaged_record_of_the_training_is_named(
    tiny_file, tmp_path, monkeypatch, capsys, training, key
):
    from egocap.detect.weights import load_weights, save_weights

    save_weights(tmp_path / "mine.safetensors", load_weights(tiny_file), training)
    words = ["egocap", "weights", "show", str(tmp_path / "mine.safetensors")]
    monkeypatch.setattr("sys.argv", words)
    assert main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"mine.safetensors, key '{key}'" in line


def test_scores_without_a_joint_are_shown(tiny_file, tmp_path, monkeypatch, capsys):
    from egocap.detect.weights import load_weights, save_weights

    save_weights(
        tmp_path / "m.safetensors", load_weights(tiny_file), {"scores": {"pck": float("nan")}}
    )
    assert "pck nan" in output(monkeypatch, capsys, "show", tmp_path / "m.safetensors")


def test_a_file_that_is_no_weights_is_refused(tmp_path, monkeypatch, capsys):
    (tmp_path / "no.safetensors").write_bytes(b"no")
    monkeypatch.setattr("sys.argv", ["egocap", "weights", "show", str(tmp_path / "no.safetensors")])
    assert main() == 2
    assert "no.safetensors" in capsys.readouterr().err
