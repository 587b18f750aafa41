"""`egocap detect`, `egocap calibrate-detector`, and tracking from learned detections."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from egocap.data.detections import load_detections
from egocap.data.track import load_track
from egocap.detect.engine import fastest_engine
from egocap.detect.weights import open_weights


def test_detections_say_where_they_are_from(egocap, tiny_sequence, tiny_file, tmp_path):
    code, out, _ = egocap("detect", tiny_sequence, "--out", "new/det.npz", "--weights", tiny_file,
                          "--threads", 1, "--json")  # fmt: skip
    assert code == 0
    summary = json.loads(out)
    found = load_detections("new/det.npz")
    assert summary["frames"] == len(found.times) == 7
    assert summary["source"] == found.source == f"learned:{open_weights(tiny_file).name}"
    assert summary["detections_per_frame"] == pytest.approx(found.valid.sum() / 7)
    assert summary["frames_without"].keys() == {"left", "right"}
    code, out, _ = egocap("detect", tiny_sequence, "--out", "det.npz", "--weights", tiny_file,
                          "--frames", 3)  # fmt: skip
    assert code == 0 and "3 frames" in out
    assert np.array_equal(load_detections("det.npz").valid, found.valid[:3])


def test_damaged_weights_are_named(egocap, tiny_sequence, tiny_file):
    """Not the cache, to which the network is exported from them."""
    content = bytearray(tiny_file.read_bytes())
    content[-2:] = b"\xff\x7f"  # not a number, in half precision
    Path("w.safetensors").write_bytes(bytes(content))
    code, out, err = egocap("detect", tiny_sequence, "--out", "d.npz", "--weights", "w.safetensors")
    assert (code, out) == (2, "") and err.startswith("egocap: w.safetensors, key "), err
    assert "not finite" in err and len(err.splitlines()) == 1


def test_tracking_from_learned_detections(egocap, tiny_sequence, tiny_file):
    code, _, err = egocap("track", tiny_sequence, "--out", "t.npz", "--detections",
                          f"learned:{tiny_file}", "--save-detections", "d.npz")  # fmt: skip
    assert code == 0, err
    name = load_track("t.npz").config["detections"]
    assert name == load_detections("d.npz").source and str(name).startswith("learned:tiny-")


def test_detections_of_several_sequences_are_tracked(egocap, tiny_sequence, tiny_file, tmp_path):
    pair = [shutil.copytree(tiny_sequence, tmp_path / name) for name in ("walk", "run")]
    code, out, err = egocap("detect", *pair, "--out", "found", "--weights", tiny_file)
    assert code == 0 and "found: 2 of 2 recordings" in out, err
    one = load_detections("found/run.detections.npz")
    code, _, err = egocap("track", *pair, "--detections", "found", "--out", "tracks")
    assert code == 0, err
    assert load_track("tracks/run.track.npz").config["detections"] == one.source


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--weights none.safetensors", "none.safetensors: no such file"),
        ("--weights manifest.json", "safetensors"),
        ("--engine tflite", "onnxruntime"),
        ("--threads 0", "0 threads"),
        ("--frames 0", "0 frames"),
        ("--frames 99", "1 to 7"),
    ],
)
def test_bad_wishes_are_one_line(egocap, tiny_sequence, tiny_file, tmp_path, words, says):
    shutil.copy(tiny_sequence / "manifest.json", tmp_path)
    given = words.split()
    given += [] if "--weights" in given else ["--weights", str(tiny_file)]
    code, out, err = egocap("detect", tiny_sequence, "--out", "d.npz", *given)
    assert (code, out) == (2, "") and says in err.splitlines()[-1], err
    assert not (tmp_path / "d.npz").exists()


def test_other_sources_are_listed(egocap, tiny_sequence):
    code, _, err = egocap("track", tiny_sequence, "--out", "t.npz", "--detections", "heatmap")
    assert code == 2
    for word in ("simulated:SIGMA", "learned", ".npz"):
        assert word in err


def test_calibration_is_written_and_repeatable(egocap, tiny_sequence, tiny_file):
    written = []
    for name in ("a", "b"):
        code, out, err = egocap("calibrate-detector", tiny_sequence, "--weights", tiny_file,
                                "--out", f"{name}.safetensors", "--json")  # fmt: skip
        assert code == 0, err
        written.append(open_weights(f"{name}.safetensors"))
        assert json.loads(out)["scale"] == written[-1].calibration.scale
    first, second = written
    assert first.sha256 == second.sha256
    assert fastest_engine(first).endswith("-int8")
    assert first.training["calibration"]["views"] == 14
    assert first.training["command"] == "none"  # what it was trained with stays
    found = first.calibration
    assert found != open_weights(tiny_file).calibration
    assert found.log_sigma_seen != 0.0
