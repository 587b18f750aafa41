"""UnrealEgo's layout and its four successors: round trips of miniatures, and parts that miss."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.datasets.calibration import SHIPPED
from egocap.datasets.unrealego import recordings
from egocap.errors import FileError
from egocap.geometry import axis_angle, rigid
from tests.egocap.datasets.miniature import MIXAMO, UNREALEGO

SIX_CM = np.array([0.06, 0.0, 0.0])
PLACE = "KyotoAlley/Day/rp_manuel/SKM_Glasses/016/dance_01"


def write_unrealego(shot, folder, names, device=False, world=(100.0, -100.0, 100.0)):
    """fisheye_final_image/camera_left/final_7.png, json/frame_7.json, ...: every 2nd number."""
    for t in range(len(shot)):
        n = 7 + 2 * t
        joints = {}
        for name, label in names.items():
            joints[name] = {"trans": (np.array(shot.joint(label, shot.world[t])) * world).tolist(),
                            "rot": [0.0, 0.0, 0.0]}  # fmt: skip
            if device:
                joints[name]["device_pts3d"] = [100 * x for x in shot.joint(label, shot.device[t])]
            for v, side in enumerate(("left", "right")):
                point = shot.joint(label, 100 * shot.camera[t, v])
                joints[name][f"camera_{side}_pts3d"] = point
                joints[name][f"camera_{side}_pts2d"] = shot.joint(label, shot.pixels[t, v])
        (folder / "json").mkdir(parents=True, exist_ok=True)
        content = {"ground_z_value": 0.0, "joints": joints, "camera_left": {"trans": [0, 0, 0]}}
        (folder / "json" / f"frame_{n}.json").write_text(json.dumps(content))
        for v, side in enumerate(("left", "right")):
            shot.write(folder / f"fisheye_final_image/camera_{side}/final_{n}.png", t, v)


def write_ego4view(shot, folder, json_folder, suffix, trans, world):
    """fisheye_rgb/camera_front_left/frame_7.jpg, json_smplx/frame_7.json: four cameras."""
    for t in range(len(shot)):
        n = 7 + 2 * t
        joints = {}
        for name, label in MIXAMO.items():
            joints[name] = {
                trans: (np.array(shot.joint(label, shot.world[t])) * world).tolist(),
                "device_pts3d": shot.joint(label, 100 * shot.device[t]),
            }
            for v, side in enumerate(FOUR):
                joints[name][f"camera_{side}_pts3d"] = shot.joint(label, 100 * shot.camera[t, v])
                joints[name][f"camera_{side}_pts2d"] = shot.joint(label, shot.pixels[t, v])
        (folder / json_folder).mkdir(parents=True, exist_ok=True)
        (folder / json_folder / f"frame_{n}.json").write_text(json.dumps({"joints": joints}))
        for v, side in enumerate(FOUR):
            shot.write(folder / f"fisheye_rgb/camera_{side}/frame_{n}.{suffix}", t, v)


FOUR = ("front_left", "front_right", "back_left", "back_right")


@pytest.fixture
def glasses(shoot, ocam):
    """Two parallel cameras 12 cm apart, as eyeglasses carry them."""
    lens = ocam("camera_front_left")
    return shoot([lens, lens], [rigid(np.eye(3), side * SIX_CM) for side in (-1, 1)])


@pytest.fixture
def miniature(glasses, tmp_path):
    write_unrealego(glasses, tmp_path / PLACE, UNREALEGO)
    calibration = (SHIPPED / "camera_front_left.json").read_text()
    (tmp_path / "fisheye_calibration_UEP.json").write_text(calibration)
    return tmp_path


@pytest.mark.parametrize("dataset", ["unrealego", "unrealego2"])
def test_eyeglasses_round_trip(dataset, miniature, glasses, check):
    (recording,) = recordings(dataset, miniature)
    check(recording, glasses, UNREALEGO.values())
    assert recording.name == PLACE and recording.category == "016"
    assert recording.frames == (7, 9, 11, 13, 15, 17)
    assert np.allclose(recording.times, 0.08 * np.arange(6))
    assert recording.rig.views == ("left", "right")
    baseline = recording.rig.T_head_camera[:, :3, 3]
    assert np.allclose(baseline[0] - baseline[1], [0, 0.12, 0])  # the left one is on the left
    (alone,) = recordings(dataset, miniature / PLACE)
    assert alone.name == "dance_01" and np.array_equal(alone.labels.points, recording.labels.points)


def test_a_rig_given_moves_cameras_and_labels_together(miniature, glasses, check):
    (recording,) = recordings("unrealego", miniature)
    turned = rigid(axis_angle(np.array([0.0, 1.0, 0.0]), 0.3), np.array([0.05, 0.0, -0.04]))
    moved = replace(
        recording.rig,
        mounts=tuple(
            replace(m, T_head_camera=turned @ m.T_head_camera) for m in recording.rig.mounts
        ),
    )
    (other,) = recordings("unrealego", miniature, moved)
    check(other, glasses, UNREALEGO.values())
    assert np.allclose(other.T_head_device, turned @ recording.T_head_device, atol=1e-6)
    assert np.abs(other.labels.joints_head - recording.labels.joints_head).max() > 0.1


def test_frames_without_labels_have_the_nominal_rig(miniature, glasses):
    (labelled,) = recordings("unrealego2", miniature)
    for path in (miniature / PLACE / "json").iterdir():
        path.unlink()
    (recording,) = recordings("unrealego2", miniature)
    assert recording.labels is None and len(recording) == len(glasses)
    assert np.allclose(recording.rig.T_head_camera, labelled.rig.T_head_camera)


def test_real_world_rig_round_trip(shoot, ocam, tmp_path, check):
    lenses = [ocam("camera_front_left"), ocam("camera_front_right")]
    turned = axis_angle(np.array([0.0, 1.0, 0.0]), 0.1)
    shot = shoot(lenses, [rigid(turned, -SIX_CM), rigid(turned.T, SIX_CM)])
    folder = tmp_path / "2024_01_01/S1/seq_2-1"
    write_unrealego(shot, folder, MIXAMO, device=True, world=100.0)
    for side in ("left", "right"):
        text = (SHIPPED / f"camera_front_{side}.json").read_text()
        (tmp_path / f"camera_{side}.json").write_text(text)
    (recording,) = recordings("unrealego-rw", tmp_path)
    check(recording, shot, MIXAMO.values())
    for path in (folder / "json").iterdir():
        path.unlink()
    with pytest.raises(FileError, match=r"without labels the rig is unknown.*--rig"):
        list(recordings("unrealego-rw", tmp_path))
    (given,) = recordings("unrealego-rw", tmp_path, recording.rig)
    assert given.rig == recording.rig and given.labels is None


@pytest.mark.parametrize(
    ("dataset", "json_folder", "suffix", "trans", "world"),
    [("ego4view-syn", "json_smplx_gendered", "jpg", "trans_blender", 1.0),
     ("ego4view-rw", "json_smplx", "png", "trans", 100.0)],
)  # fmt: skip
def test_four_views_round_trip(dataset, json_folder, suffix, trans, world, shoot, ocam, tmp_path,
                               check):  # fmt: skip
    back = axis_angle(np.array([0.0, 0.0, 1.0]), np.pi)
    poses = [rigid(np.eye(3), -SIX_CM), rigid(np.eye(3), SIX_CM),
             rigid(back, [-0.06, 0.37, 0.0]), rigid(back, [0.06, 0.37, 0.0])]  # fmt: skip
    shot = shoot([ocam(f"camera_{side}") for side in FOUR], poses)
    write_ego4view(shot, tmp_path / "rp_aaron/1001", json_folder, suffix, trans, world)
    (recording,) = recordings(dataset, tmp_path)  # calibrations are shipped
    check(recording, shot, MIXAMO.values())
    assert recording.rig.views == FOUR and recording.name == "rp_aaron/1001"
    shipped = load_rig(Path(__file__).parents[3] / "scenes/rigs/ego4view.toml")
    assert shipped.cameras == recording.rig.cameras and shipped.views == FOUR
    assert np.allclose(shipped.T_head_camera, recording.rig.T_head_camera, atol=1e-6)


def test_missing_and_foreign_parts_are_named(miniature, tmp_path):
    folder, frame = miniature / PLACE, miniature / PLACE / "json/frame_9.json"
    content = json.loads(frame.read_text())

    def refused(match, dataset="unrealego", **changed):
        frame.write_text(json.dumps(content | changed))
        with pytest.raises(FileError, match=match):
            list(recordings(dataset, miniature))
        frame.write_text(json.dumps(content))

    joints = content["joints"]
    refused(r"frame_9\.json, key 'hand_l'", joints={
        k: v for k, v in joints.items() if k != "hand_l"})  # fmt: skip
    refused("another version", "unrealego-rw")
    refused(r"shape \(2,\)", joints=joints | {
        "head": joints["head"] | {"camera_left_pts3d": [1.0, 2.0]}})  # fmt: skip
    moved = joints["head"] | {"camera_left_pts3d": [0.0, 0.0, 0.0]}
    refused("not parallel", joints=joints | {"head": moved})
    frame.write_text("{")
    with pytest.raises(FileError, match=r"frame_9\.json.*not JSON"):
        list(recordings("unrealego", miniature))
    frame.write_text(json.dumps(content))
    image = folder / "fisheye_final_image/camera_right/final_11.png"
    kept = image.read_bytes()
    image.unlink()
    with pytest.raises(FileError, match=r"camera_right.*no image of frame 11"):
        list(recordings("unrealego", miniature))
    image.write_bytes(kept[:100])
    (recording,) = recordings("unrealego", miniature)
    with pytest.raises(FileError, match="damaged"):
        recording.images(2)
    (miniature / "fisheye_calibration_UEP.json").unlink()
    with pytest.raises(FileError, match=r"no calibration.*fisheye_calibration_UEP\.json"):
        list(recordings("unrealego", miniature))
    with pytest.raises(FileError, match="no such folder"):
        list(recordings("unrealego", tmp_path / "absent"))


def test_a_world_that_is_not_rigid_to_the_device_gives_no_head_pose(miniature, glasses, tmp_path):
    bent = replace(glasses, world=glasses.world * [1.0, 1.1, 1.0])
    write_unrealego(bent, miniature / PLACE, UNREALEGO)
    (recording,) = recordings("unrealego", miniature)
    assert recording.labels.T_world_head is None
