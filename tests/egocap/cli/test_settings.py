"""The tracker's settings on the command line: --advanced and --config."""

import sys

import pytest

from egocap.cli import main
from egocap.cli.settings import BASIC, read_settings
from egocap.errors import FileError
from egocap.pose.config import TrackerConfig


def show(monkeypatch, capsys, *words):
    monkeypatch.setattr(sys, "argv", ["egocap", *words])
    code = main()
    shown = capsys.readouterr()
    return code, shown.out + shown.err


def flags_of(text):
    return {word for word in text.replace("│", " ").split() if word.startswith("--")}


@pytest.mark.parametrize("command", ["track", "live"])
def test_help_shows_a_few_settings_and_all_with_advanced(monkeypatch, capsys, command):
    short = flags_of(show(monkeypatch, capsys, command, "--help")[1])
    full = flags_of(show(monkeypatch, capsys, command, "--advanced", "--help")[1])
    assert len(full - short) == len(vars(TrackerConfig())) - len(BASIC)
    assert {"--no-multistart", "--no-appearance-check", "--colour"} <= short
    assert {"--no-use-modes", "--lambda-motion", "--zeta"} <= full - short


def test_help_of_a_flag_describes_the_flag(monkeypatch, capsys):
    _, text = show(monkeypatch, capsys, "track", "--help")
    assert "Keep detections that the images contradict." in " ".join(text.replace("│", " ").split())
    assert "Off:" not in text and "True" not in text


def test_advanced_settings_need_advanced(monkeypatch, capsys):
    words = ("track", "none", "--out", "t.npz", "--zeta", "0.5")
    assert "--zeta" in show(monkeypatch, capsys, *words)[1]
    code, said = show(monkeypatch, capsys, *words, "--advanced")
    assert code == 2 and "zeta" not in said


def test_settings_that_exclude_each_other_are_named(monkeypatch, capsys):
    words = ("track", "none", "--out", "t.npz", "--advanced")
    code, said = show(monkeypatch, capsys, *words, "--lag", "0.1")
    assert code == 2 and "fixed-lag" in said
    gaussian = ("--smoothing", "fixed-lag", "--motion-prior", "gaussian")
    code, said = show(monkeypatch, capsys, *words, *gaussian)
    assert code == 2 and "motion prior 'gaussian'" in said


def test_settings_from_a_file(tmp_path, monkeypatch, capsys):
    path = tmp_path / "settings.toml"
    path.write_text('smoothing = "none"\nzeta = 1\nmultistart = false\n')
    expected = TrackerConfig(smoothing="none", zeta=1, multistart=False)
    assert read_settings(path, TrackerConfig()) == expected
    _, text = show(monkeypatch, capsys, "track", "--config", str(path), "--help")
    assert "--multistart" in flags_of(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("speed = 2.0", "key 'speed'"),
        ('zeta = "fast"', "key 'zeta'"),
        ("colour = 1", "key 'colour'"),
        ('smoothing = "kalman"', "'interval', 'fixed-lag', 'gaussian' or 'none'"),
        ("robust_scale = 0.0", "robust_scale = 0.0"),
        ("zeta =", "not TOML"),
    ],
)
def test_wrong_files_are_named(tmp_path, monkeypatch, capsys, text, said):
    path = tmp_path / "settings.toml"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        read_settings(path, TrackerConfig())
    assert said in str(caught.value) and "settings.toml" in str(caught.value)
    words = ("track", "none", "--out", "t.npz", "--config", str(path))
    code, printed = show(monkeypatch, capsys, *words)
    assert code == 2 and said in printed


def test_an_unknown_key_lists_the_valid_ones(tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text("restarts = true")
    with pytest.raises(FileError, match="multistart"):
        read_settings(path, TrackerConfig())
