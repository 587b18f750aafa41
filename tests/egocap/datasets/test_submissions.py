"""Submission files read back by the code of each format: json, pickle, scipy, the label readers."""

import io
import json
import pickle
import zipfile

import numpy as np
import pytest
from scipy.io import loadmat

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.catalogue import DATASETS
from egocap.datasets.egocap_zips import _rows
from egocap.datasets.mounting import looking_down
from egocap.datasets.recording import Labels, Recording
from egocap.datasets.submissions import FORMATS, Prediction, write_submission
from egocap.datasets.unrealego import LAYOUTS
from egocap.errors import FileError, InputError
from egocap.geometry import rigid, transform
from tests.egocap.datasets.miniature import MIXAMO, MO2CAP2, UNREALEGO

FRAMES = (7, 9, 11)
INDEX = [LABEL_INDEX[label] for label in MO2CAP2]


@pytest.fixture
def predict(shoot, ocam):
    """A prediction for a data set, and its joints in the camera's and the device's frame."""
    shot = shoot([ocam("camera_front_left")], [rigid(np.eye(3), [-0.06, 0.0, 0.0])], T=3)

    def make(dataset, name="S1/seq_1"):
        layout = LAYOUTS.get(dataset)
        T_head_device = looking_down(layout.forward, layout.up) if layout else looking_down(0, 0)
        T_head_camera = T_head_device @ shot.T_device_camera[0]
        rig = Rig("r", (Mount("camera", shot.cameras[0], T_head_camera),))
        world = np.tile(rigid(np.eye(3), [1.0, 2.0, 3.0]), (3, 1, 1))
        joints = transform(T_head_device, shot.device)
        all_ = np.ones((3, 18), bool)
        labels = Labels(joints, all_, shot.pixels, all_[:, None], world)
        recording = Recording(
            dataset, name, rig, np.arange(3.0), FRAMES, ((),) * 3, labels, T_head_device
        )
        return Prediction(recording, joints, all_), shot

    return make


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {name: json.loads(archive.read(name)) for name in archive.namelist()}


@pytest.mark.parametrize(
    ("dataset", "folder", "names"),
    [("unrealego2", "UnrealEgoData2_test_pose", UNREALEGO),
     ("unrealego-rw", "UnrealEgoData_rw_test_pose", MIXAMO),
     ("ego4view-rw", "ego4view-rw_pose", MIXAMO)],
)  # fmt: skip
def test_benchmark_frames_are_device_relative_centimetres(dataset, folder, names, predict,
                                                          tmp_path):  # fmt: skip
    prediction, shot = predict(dataset)
    other, _ = predict(dataset, "S2/seq_1")
    write_submission([prediction, other], tmp_path / "poses.zip")
    found = members(tmp_path / "poses.zip")
    assert set(found) == {
        f"{folder}/S{s}/seq_1/json/frame_{n}.json" for s in (1, 2) for n in FRAMES
    }
    for t, n in enumerate(FRAMES):
        pose = found[f"{folder}/S1/seq_1/json/frame_{n}.json"]
        assert list(pose) == list(names)
        for name, label in names.items():
            assert pose[name] == pytest.approx(shot.joint(label, 100 * shot.device[t]), abs=1e-4)


@pytest.mark.parametrize("dataset", ["sceneego", "egopw", "egowholemocap"])
def test_a_pickled_list_of_poses_in_metres(dataset, predict, tmp_path):
    prediction, shot = predict(dataset)
    write_submission([prediction], tmp_path / "poses.pkl")
    poses = pickle.loads((tmp_path / "poses.pkl").read_bytes())
    assert isinstance(poses, list) and np.allclose(poses, shot.camera[:, 0, INDEX], atol=1e-6)


def test_the_other_sets_poses_are_written_as_their_labels(predict, tmp_path):
    prediction, shot = predict("mo2cap2")
    write_submission([prediction], tmp_path / "poses.mat")
    poses = loadmat(io.BytesIO((tmp_path / "poses.mat").read_bytes()))["pose_pred"]
    assert np.allclose(poses, 1000 * shot.camera[:, 0, INDEX])
    prediction, shot = predict("egocap")
    write_submission([prediction], tmp_path / "poses.mddd")
    rows = _rows((tmp_path / "poses.mddd").read_text(), tmp_path)
    assert np.allclose(rows[:, 1:].reshape(-1, 18, 3), 1000 * shot.camera[:, 0], atol=1e-5)
    assert tuple(rows[:, 0]) == FRAMES
    prediction, shot = predict("xr-egopose")
    write_submission([prediction], tmp_path / "xr.zip")
    frame = members(tmp_path / "xr.zip")["S1/seq_1/json/000009.json"]
    names = [joint["name"].removeprefix("mixamorig:") for joint in frame["joints"]]
    expected = [shot.joint(MIXAMO[name], 100 * shot.camera[1, 0]) for name in names]
    assert np.allclose(np.array(frame["pts3d_fisheye"]).T, expected)
    prediction, shot = predict("egobody3m")
    write_submission([prediction], tmp_path / "body.zip")
    rows = members(tmp_path / "body.zip")["S1/seq_1/frame0011.json"]["joint_positions_world_cm"]
    x, y, z = np.add(prediction.joints_head[2, LABEL_INDEX["left_elbow"]], [1.0, 2.0, 3.0])
    assert rows[3] == pytest.approx([100 * x, 100 * z, -100 * y])  # y is up
    assert len(rows) == 26 and rows[10] is None


def test_every_data_set_has_a_format():
    assert set(FORMATS) == set(DATASETS)


def test_what_cannot_be_submitted_is_refused(predict, tmp_path):
    prediction, _ = predict("unrealego2")
    with pytest.raises(FileError, match=r"format of unrealego2 is \.zip"):
        write_submission([prediction], tmp_path / "poses.json")
    with pytest.raises(InputError, match="of 2 data sets"):
        write_submission([prediction, predict("egopw")[0]], tmp_path / "poses.zip")
    valid = prediction.valid.copy()
    valid[1, LABEL_INDEX["left_wrist"]] = valid[:, LABEL_INDEX["left_hand"]] = False
    with pytest.raises(InputError, match=r"no hand_l in frame 9 \(1 in all\)"):
        write_submission([prediction._replace(valid=valid)], tmp_path / "poses.zip")
    assert not list(tmp_path.iterdir())
