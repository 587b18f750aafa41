"""Scores on recordings: joints without a label do not count, frames of reference are respected."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.rig import Mount, Rig
from egocap.data.detections import Detections
from egocap.datasets.pictures import Picture
from egocap.datasets.recording import Labels, Recording
from egocap.datasets.scoring import evaluate_recording, score_detections
from egocap.errors import InputError
from egocap.evaluation.predictions import Predictions
from egocap.geometry import transform

HANDS = [LABEL_INDEX["left_hand"], LABEL_INDEX["right_hand"]]
HEAD = LABEL_INDEX["head"]


@pytest.fixture
def recording(shoot, ocam, tmp_path):
    return make(shoot([ocam("camera_front_left")], [np.eye(4)], T=40), tmp_path)


def make(shot, folder, dataset="sceneego", **changed):
    T = len(shot)
    rig = Rig("r", (Mount("camera", shot.cameras[0], np.eye(4)),), 25.0)
    labelled = np.ones((T, 18), bool)
    labelled[:, [*HANDS, HEAD]] = False
    joints = np.where(labelled[..., None], shot.camera[:, 0], 0.0)
    labels = Labels(joints, labelled, shot.pixels, rig.project(shot.camera[:, 0])[1].swapaxes(0, 1))
    pictures = tuple((Picture(folder / f"{t}.png"),) for t in range(T))
    fields = {"labels": labels} | changed
    return Recording(dataset, "a", rig, np.arange(T) / 25, tuple(range(T)), pictures, **fields)


def test_only_labelled_joints_count(recording, shoot, ocam):
    shot = shoot([ocam("camera_front_left")], [np.eye(4)], T=40)
    joints = shot.camera[:, 0].copy()
    joints[:, HANDS] += 10.0
    assert evaluate_recording(joints, recording).mpjpe_mm < 1e-9
    joints[:, LABEL_INDEX["left_wrist"]] += [0.03, 0.0, 0.0]
    report = evaluate_recording(joints, recording)
    assert report.protocol == "mo2cap2-15" and report.mpjpe_mm == pytest.approx(30 / 15)
    assert report.coverage_share == 1.0 and report.pck3d_100 == 100.0
    report = evaluate_recording(joints, recording, protocol="egocap-18")
    assert report.mpjpe_mm == pytest.approx(2.0) and report.per_joint_mm["left_hand"] is None
    joints[:, LABEL_INDEX["left_ankle"]] = np.nan
    assert evaluate_recording(joints, recording).coverage_share == pytest.approx(14 / 15)


def test_predictions_in_a_camera_frame_and_without_a_world(recording):
    labels = recording.labels
    T = np.arange(len(recording))
    camera = transform(recording.rig.T_camera_head[0], labels.joints_head)
    found = Predictions(camera, labels.labelled, "camera:camera", "m", T, method="mine")
    report = evaluate_recording(found, recording)
    assert report.mpjpe_mm < 1e-9 and report.method == "mine"
    world = Predictions(camera, labels.labelled, "world", "m", T)
    with pytest.raises(InputError, match="no head pose in the world"):
        evaluate_recording(world, recording)


def test_labels_in_an_unknown_frame_need_an_alignment(shoot, ocam, tmp_path):
    shot = shoot([ocam("camera_front_left")], [np.eye(4)], T=40)
    recording = make(shot, tmp_path, "mo2cap2", known_frame=False)
    joints = 1.1 * shot.camera[:, 0]
    report = evaluate_recording(joints, recording)
    assert report.protocol == "mo2cap2-15-ba-rigid" and report.mpjpe_mm < 1e-6
    assert report.velocity_error is report.accel_error is None
    assert {"mo2cap2-15", "mo2cap2-15-mid-hip"}.isdisjoint(report.other_protocols_mm)
    with pytest.raises(InputError, match="unrelated to the camera"):
        evaluate_recording(joints, recording, protocol="mo2cap2-15")


def test_what_cannot_be_scored_is_refused(recording, shoot, ocam, tmp_path):
    shot = shoot([ocam("camera_front_left")], [np.eye(4)], T=40)
    with pytest.raises(InputError, match="no labels to score against"):
        evaluate_recording(shot.camera[:, 0], make(shot, tmp_path, labels=None))
    nothing = np.zeros((40, 18), bool)
    pixels = Labels(np.zeros((40, 18, 3)), nothing, shot.pixels, np.ones((40, 1, 18), bool))
    with pytest.raises(InputError, match="the truth has no joint of mo2cap2-15"):
        evaluate_recording(shot.camera[:, 0], make(shot, tmp_path, labels=pixels))
    with pytest.raises(InputError, match="20 of 40 frames are missing"):
        evaluate_recording(shot.camera[::2, 0], recording)


def test_detections_are_scored_on_the_2d_labels(recording):
    labels = recording.labels
    shape = labels.in_view.shape
    found = Detections(recording.times, labels.points + [3.0, 4.0], np.ones(shape),
                       np.ones(shape), np.ones(shape, bool), "r")  # fmt: skip
    score = score_detections(found, recording)
    assert score.mean_px == pytest.approx(5.0 * 640 / recording.rig.cameras[0].width)
    assert score.pck20 == 100.0
