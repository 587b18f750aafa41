"""SceneEgo's and EgoPW's pickles, written by `pickle` itself."""

import json
import os
import pickle
from dataclasses import replace

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.datasets.calibration import SHIPPED
from egocap.datasets.sceneego import recordings
from egocap.errors import FileError
from tests.egocap.datasets.miniature import MO2CAP2

INDEX = [LABEL_INDEX[label] for label in MO2CAP2]


@pytest.fixture
def shot(shoot, ocam):
    return shoot([ocam("egowholemocap_fisheye")], [np.eye(4)])


@pytest.fixture
def root(tmp_path):
    text = (SHIPPED / "egowholemocap_fisheye.json").read_text()
    for name in ("fisheye.calibration_05_08.json", "fisheye.calibration.json"):
        (tmp_path / name).write_text(text)
    return tmp_path


def entries(shot):
    """SceneEgo's annotations: metres; the studio's y is up; one frame without a pose."""
    rows = []
    for t in range(len(shot)):
        world = shot.world[t, INDEX]
        world = np.stack([world[:, 0], world[:, 2], -world[:, 1]], 1)
        rows.append({
            "ext_id": 1000 + t, "calib_board_pose": np.eye(4), "ego_camera_matrix": np.eye(4),
            "ego_pose_gt": shot.camera[t, 0, INDEX], "ext_pose_gt": world,
            "image_name": f"img_{503 + t:06d}.jpg",
        })  # fmt: skip
    return [*rows, rows[0] | {"ext_id": 1100, "ego_pose_gt": None}]


def write_images(shot, folder):
    for t in range(len(shot)):
        shot.write(folder / f"imgs/img_{503 + t:06d}.jpg", t, 0)


@pytest.mark.parametrize("released", [True, False])
def test_sceneego_round_trip(released, root, shot, check):
    folder = root / "diogo1"
    write_images(shot, folder)
    rows = entries(shot)
    if not released:  # the authors' own file names no image
        rows = [{k: v for k, v in row.items() if k != "image_name"} for row in rows]
        (folder / "syn.json").write_text(json.dumps({"ego": 3, "ext": 500}))
    name = "annotation.pkl" if released else "local_pose_gt.pkl"
    (folder / name).write_bytes(pickle.dumps(rows))
    (recording,) = recordings("sceneego", root)
    check(recording, shot, MO2CAP2, pixels=False)
    mount = replace(recording.rig.mounts[0], T_head_camera=np.eye(4))
    (other,) = recordings("sceneego", root, replace(recording.rig, mounts=(mount,)))
    check(other, shot, MO2CAP2, pixels=False)
    assert recording.name == "diogo1" and recording.frames == tuple(range(503, 509))


def test_egopw_round_trip(root, shot, check):
    folder = root / "ayush/kitchen2"
    write_images(shot, folder)
    rows = [{"image_path": rf"X:\EgoPW\ayush\kitchen2\imgs\img_{503 + t:06d}.jpg",
             "optimized_local_pose": shot.camera[t, 0, INDEX].astype(np.float32),
             "joints_2d": shot.pixels[t, 0, INDEX]} for t in range(len(shot))]  # fmt: skip
    (folder / "pseudo_gt.pkl").write_bytes(pickle.dumps(rows[::-1]))
    (recording,) = recordings("egopw", root)
    check(recording, shot, MO2CAP2, world=False)


def test_missing_and_foreign_parts_are_named(root, shot, caplog):
    folder = root / "diogo1"
    write_images(shot, folder)
    path, rows = folder / "annotation.pkl", entries(shot)

    def refused(match, content):
        path.write_bytes(pickle.dumps(content))
        with pytest.raises(FileError, match=match):
            list(recordings("sceneego", root))

    refused("valid: a list of annotations", {"data": rows})
    refused(r"key 'ego_pose_gt'.*another version", [{"ext_id": 1}])
    refused(r"shape \(14, 3\)", [rows[0] | {"ego_pose_gt": np.zeros((14, 3))}])
    refused("annotated twice", [rows[0], rows[0]])
    refused("has none of the 1 annotated", [rows[0] | {"image_name": "img_999999.jpg"}])
    refused(r"syn\.json.*no such file", [rows[0] | {"image_name": None}])

    class Attack:
        def __reduce__(self):
            return os.system, ("true",)

    refused("not plain data", [rows[0] | {"extra": Attack()}])
    path.write_bytes(pickle.dumps([*rows[:3], rows[3] | {"image_name": "img_999999.jpg"}]))
    (recording,) = recordings("sceneego", root)
    assert len(recording) == 3 and "1 annotated images are missing" in caplog.text
