"""Recordings as sequences: pictures by reference or copied, and a track scored against labels."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from egocap.cli.program import main
from egocap.data.sequence import open_sequence
from egocap.data.track import Track
from egocap.datasets.catalogue import open_dataset
from egocap.datasets.importing import import_recording
from egocap.datasets.scoring import evaluate_recording
from egocap.datasets.unrealego import recordings
from egocap.errors import FileError, InputError
from egocap.geometry import rigid
from tests.egocap.datasets.miniature import MIXAMO


@pytest.fixture
def shot(shoot, ocam):
    poses = [rigid(np.eye(3), [x, 0.0, 0.0]) for x in (-0.06, 0.06)]
    return shoot([ocam(f"camera_front_{side}") for side in ("left", "right")], poses)


@pytest.fixture
def root(shot, tmp_path):
    """Two views of Ego4View; frame numbers have a gap."""
    folder = tmp_path / "data/rp_aaron/1001"
    for t in range(len(shot)):
        n = t if t < 3 else t + 4
        joints = {name: {"trans_blender": shot.joint(label, shot.world[t]),
                         "device_pts3d": shot.joint(label, 100 * shot.device[t])}
                  for name, label in MIXAMO.items()}  # fmt: skip
        for name, label in MIXAMO.items():
            for v, side in enumerate(("front_left", "front_right")):
                joints[name][f"camera_{side}_pts3d"] = shot.joint(label, 100 * shot.camera[t, v])
                joints[name][f"camera_{side}_pts2d"] = shot.joint(label, shot.pixels[t, v])
        path = folder / f"json_smplx_gendered/frame_{n}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"joints": joints}))
        for v, side in enumerate(("front_left", "front_right")):
            shot.write(folder / f"fisheye_rgb/camera_{side}/frame_{n}.png", t, v)
    shot.write(folder / "fisheye_rgb/camera_front_left/frame_99.png", 0, 0)  # without labels
    return tmp_path / "data"


@pytest.mark.parametrize("copy", [False, True])
def test_a_recording_becomes_a_sequence(copy, root, shot, tmp_path):
    (recording,) = recordings("ego4view-syn", root)
    sequence = import_recording(recording, tmp_path / "out", copy=copy)
    assert np.allclose(sequence.times, np.array([0, 1, 2, 7, 8, 9]) / 25)
    assert sequence.rig == recording.rig and sequence.manifest.fps == 25.0
    for t in range(len(shot)):
        frame = sequence.frame(t)
        assert frame.present == (True, True) and frame.time == sequence.times[t]
        for v in range(2):
            assert np.array_equal(frame.images[v], shot.image(t, v))
    with pytest.raises(FileError, match="has no truth"):
        _ = sequence.truth
    shards = list((tmp_path / "out").glob("*.tar"))
    assert bool(shards) == copy
    again = import_recording(recording, tmp_path / "out", copy=copy)
    assert again.manifest == sequence.manifest
    with pytest.raises(InputError, match="holds another sequence"):
        import_recording(recording, tmp_path / "out", copy=not copy)


def test_pictures_that_are_no_files_of_their_own_must_be_copied(root, shot, tmp_path):
    (recording,) = recordings("ego4view-syn", root)
    pictures = tuple((row[0], replace(row[1], mirrored=True)) for row in recording.pictures)
    mirrored = replace(recording, pictures=pictures)
    with pytest.raises(InputError, match=r"'front_right' are not a folder.*--copy"):
        import_recording(mirrored, tmp_path / "out")
    sequence = import_recording(mirrored, tmp_path / "out", copy=True)
    assert np.array_equal(sequence.images(2)[1], shot.image(2, 1)[:, ::-1])


def test_a_track_of_the_sequence_is_scored_against_the_labels(root, shot, tmp_path):
    (recording,) = recordings("ego4view-syn", root)
    sequence = import_recording(recording, tmp_path / "out")
    joints = recording.labels.joints_head + [0.0, 0.01, 0.0]
    T = len(shot)
    nothing = np.zeros(T)
    track = Track(sequence.times, np.zeros((T, 37)), joints, nothing, nothing > 0, nothing, 0.1, {})
    assert evaluate_recording(track, recording).mpjpe_mm == pytest.approx(10.0)


def test_the_frame_rate_is_the_data_sets(root, tmp_path):
    (recording,) = open_dataset(f"ego4view-syn:{root}")
    rig = replace(recording.rig, frame_rate=60.0)
    (recording,) = open_dataset(f"ego4view-syn:{root}", rig)
    assert import_recording(recording, tmp_path / "out").manifest.fps == 25.0


def test_the_command(root, tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr("sys.argv", ["egocap", "import", "--dataset", f"ego4view-syn:{root}",
                                     "--out", str(out)])  # fmt: skip
    assert main() == 0
    assert "6 frames at 25 Hz, views front_left, front_right; labels reproject within 0.0" in (
        capsys.readouterr().out
    )
    assert len(open_sequence(out)) == 6
    monkeypatch.setattr("sys.argv", [*sys.argv, "--json"])
    assert main() == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"sequence": str(out), "frames": 6, "views": ["front_left", "front_right"],
                     "labels_off_px": pytest.approx(0.0, abs=0.05)}  # fmt: skip
    monkeypatch.setattr("sys.argv", ["egocap", "import", "--out", str(out)])
    assert main() == 2 and "sources and --rig FILE, or --dataset" in capsys.readouterr().err
