"""detect, track and mocap over several recordings, here and on a cluster."""

import json
import shutil

import numpy as np
import pytest

from egocap.data.track import load_track


@pytest.fixture
def two(tiny_sequence, tmp_path):
    """Folders of two sequences."""
    return [shutil.copytree(tiny_sequence, tmp_path / name) for name in ("walk", "run")]


HOW = ("--detections", "simulated:1.0", "--no-appearance-check", "--no-multistart")


def same(a, b) -> bool:
    return np.array_equal(load_track(a).angles, load_track(b).angles)


def test_a_damaged_sequence_fails_alone_and_is_tracked_once_it_is_sound(
    egocap, two, cluster, tmp_path
):
    rig = (two[1] / "rig.json").read_bytes()
    (two[1] / "rig.json").write_bytes(b"{}")
    words = ("track", *two, *HOW, "--out", "tracks", "--cluster", cluster)
    code, out, err = egocap(*words)
    assert code == 1 and "tracks: 1 of 2 recordings\n" in out and "7 frames tracked" in out
    assert [line for line in err.splitlines() if "rig.json" in line] == [
        line for line in err.splitlines() if line.startswith("egocap: tracks/run.track.npz: ")
    ]
    (two[1] / "rig.json").write_bytes(rig)
    code, out, _ = egocap(*words, "--json")
    found = json.loads(out)
    assert code == 0 and found["already_complete"] == 1 and not found["failed"]
    assert {s["frames"] for s in found["recordings"].values()} == {7}
    assert egocap("track", two[1], *HOW, "--out", "one.npz")[0] == 0
    assert same("one.npz", "tracks/run.track.npz")


def test_another_process_tracks_a_folder_of_sequences(egocap, two, tmp_path):
    code, out, err = egocap("track", tmp_path, *HOW, "--out", "tracks", "--workers", 1)
    name = f"{tmp_path.name}-walk.track.npz"
    assert code == 0 and "tracks: 2 of 2 recordings" in out, err
    assert len(load_track(tmp_path / "tracks" / name).times) == 7


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("track --out t", "no recording given"),
        ("track walk run --out t --save-detections d.npz", "--save-detections of several"),
        ("track walk --out t --workers -1", "-1 workers"),
        ("track walk ./walk --out t", "two results would be called 'walk.track.npz'"),
        ("track walk none --out t", "none: no such folder"),
        ("track walk walk/rig.json --out t", "walk/rig.json: a file, not the folder"),
        ("detect walk run --out t --cluster tcp://127.0.0.1:1", "no Dask scheduler at"),
        ("mocap a b c --rig walk/rig.json --out t", "3 sources for 2 views"),
        ("detect walk run --out t --weights walk/rig.json", "walk/rig.json: "),
        ("track walk run --out t --head-pose walk/rig.json", "walk/rig.json: "),
        ("track walk run --out t --body walk/rig.json", "walk/rig.json"),
        ("mocap a b a b --rig walk/rig.json --out t --weights walk/rig.json", "walk/rig.json: "),
    ],
)
def test_wrong_words_are_one_line(egocap, two, monkeypatch, words, says, tmp_path):
    monkeypatch.setattr("egocap.execution.cluster._TIMEOUT_S", 1)
    code, out, err = egocap(*words.split())
    assert code in (1, 2) and out == ""
    assert says in err.splitlines()[-1] and not (tmp_path / "t").exists()
