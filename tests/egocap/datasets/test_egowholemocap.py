"""EgoWholeMocap's label pickles of both versions."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.cameras.rig_files import load_rig
from egocap.datasets.egowholemocap import recordings
from egocap.errors import FileError
from tests.egocap.datasets.miniature import MO2CAP2

RENDERPEOPLE = {  # place in the 73 joints: label
    17: "head", 14: "neck", 18: "left_shoulder", 20: "left_elbow", 22: "left_wrist",
    37: "left_hand", 19: "right_shoulder", 21: "right_elbow", 23: "right_wrist",
    57: "right_hand", 1: "left_hip", 4: "left_knee", 7: "left_ankle", 10: "left_foot",
    2: "right_hip", 5: "right_knee", 8: "right_ankle", 11: "right_foot",
}  # fmt: skip


@pytest.fixture
def shot(shoot, ocam):
    return shoot([ocam("egowholemocap_fisheye")], [np.eye(4)])


def entries(shot, folder, root):
    rows = []
    for t in range(len(shot)):
        joints = np.full((73, 3), 9.0)
        joints[list(RENDERPEOPLE)] = [shot.joint(n, shot.camera[t, 0])
                                      for n in RENDERPEOPLE.values()]  # fmt: skip
        image = f"{folder}/imgs/Image{t + 1:04d}.png"
        shot.write(root / image, t, 0)
        rows.append({"img_path": image, "depth_path": "d", "seg_path": "s",
                     "renderpeople_local_joints": joints,
                     "mo2cap2_local_joints": shot.camera[t, 0, [LABEL_INDEX[n] for n in MO2CAP2]],
                     })  # fmt: skip
    return rows


def test_round_trip_with_hands(shot, tmp_path, check):
    rows = entries(shot, "render_people_adanna/dance", tmp_path)
    labels = {"data_list": {"render_people_adanna": {"dance": rows}}, "ids": [1]}
    (tmp_path / "labels.pkl").write_bytes(pickle.dumps(labels))
    (recording,) = recordings("egowholemocap", tmp_path)
    check(recording, shot, LABELS, pixels=False, world=False)
    assert recording.name == "render_people_adanna/dance"
    shipped = load_rig(Path(__file__).parents[3] / "scenes/rigs/egowholemocap.toml")
    assert shipped.cameras == recording.rig.cameras
    assert np.allclose(shipped.T_head_camera, recording.rig.T_head_camera)
    pixels, inside = recording.rig.project(recording.labels.joints_head)
    assert np.abs(pixels[0] - shot.pixels[:, 0])[inside[0]].max() < 0.01


def test_round_trip_of_the_older_labels(shot, tmp_path, check):
    rows = entries(shot, "adanna/dance", tmp_path) + entries(shot, "adanna/walk", tmp_path)
    rows = [row | {"renderpeople_local_joints": np.zeros((55, 3))} for row in rows]
    (tmp_path / "labels.pkl").write_bytes(pickle.dumps({"data_list": rows}))
    one, other = recordings("egowholemocap", tmp_path / "labels.pkl")
    check(one, shot, MO2CAP2, pixels=False, world=False)
    assert (one.name, other.name) == ("adanna/dance/imgs", "adanna/walk/imgs")


def test_missing_and_foreign_parts_are_named(shot, tmp_path):
    with pytest.raises(FileError, match=r"no \.pkl file"):
        list(recordings("egowholemocap", tmp_path))
    rows = entries(shot, "a/b", tmp_path)
    for match, content in [
        ("key 'data_list'.*another version", {"data": rows}),
        ("key 'data_list.a'", {"data_list": {"a": 3}}),
        ("no list of frames", {"data_list": {"a": {"b": []}}}),
        ("listed twice", {"data_list": [rows[0], rows[0]]}),
        ("key 'mo2cap2_local_joints'", {"data_list": [{"img_path": "a/b/Image0001.png"}]}),
    ]:
        (tmp_path / "labels.pkl").write_bytes(pickle.dumps(content))
        with pytest.raises(FileError, match=match):
            list(recordings("egowholemocap", tmp_path))
