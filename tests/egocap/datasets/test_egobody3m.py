"""EgoBody3M, zipped and unzipped: four lenses and poses found in the projected joints."""

import json
import zipfile

import numpy as np
import pytest

from egocap.cameras.camera import Camera
from egocap.cameras.rig_files import camera_rotation
from egocap.datasets.egobody3m import recordings
from egocap.errors import FileError
from egocap.geometry import UP, axis_angle, rigid, transform

JOINTS = (
    "head", None, "left_shoulder", "left_elbow", "left_wrist",
    None, "right_shoulder", "right_elbow", "right_wrist",
    "neck", None, None, None, None,
    "right_hip", "right_knee", None, "right_ankle", None, "right_foot",
    "left_hip", "left_knee", None, "left_ankle", None, "left_foot",
)  # fmt: skip
LABELLED = [name for name in JOINTS if name]


def lens(width, height, focal):
    centre = (width / 2 + 3.0, height / 2 - 2.0)
    return Camera("kannala_brandt", width, height, centre, ((focal, 0.0), (0.0, focal * 1.01)),
                  (-0.02, -0.001, 0.0002, -0.0001), 1.4)  # fmt: skip


@pytest.fixture
def shot(shoot):
    """Two downward cameras, and two that look to the sides, as a headset carries them."""
    sides = [axis_angle(np.array([0.0, 1.0, 0.0]), s * 0.7) for s in (1, -1)]
    cameras = [lens(318, 240, 110.0), lens(320, 256, 100.0), lens(320, 256, 101.0),
               lens(318, 240, 111.0)]  # fmt: skip
    poses = [rigid(sides[0], [-0.08, 0, 0]), rigid(np.eye(3), [-0.03, 0, 0]),
             rigid(np.eye(3), [0.03, 0, 0]), rigid(sides[1], [0.08, 0, 0])]  # fmt: skip
    return shoot(cameras, poses, T=30)


def content(shot, t):
    """JSON of a frame: the headset's axes are its own, the world's y is up; centimetres."""
    T_device_headset = rigid(
        axis_angle(np.array([1.0, 0, 0]), 0.9) @ axis_angle(UP, 0.3), [0, 0.02, 0]
    )
    T_world_head = rigid(axis_angle(UP, 0.1 * t), [0.01 * t, 1.0, 1.5])
    T_head_device = rigid(camera_rotation(90.0), np.zeros(3))
    T_world_device = T_world_head @ T_head_device
    to_y_up = rigid(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
    T = to_y_up @ T_world_device @ T_device_headset
    T[:3, 3] *= 100.0
    device = np.array([shot.joint(n or "neck", shot.device[t]) for n in JOINTS])
    world = transform(to_y_up @ T_world_device, device)
    data = {"frame_index": t, "world_from_headset_xf_cm": T.tolist(), "annotation_level": 1,
            "joint_positions_world_cm": (100 * world).tolist()}  # fmt: skip
    for v in range(4):
        rows = [(*shot.joint(n or "neck", shot.pixels[t, v]),
                 100 * shot.joint(n or "neck", shot.camera[t, v])[2]) for n in JOINTS]  # fmt: skip
        data[f"projected_joint_positions_cam{v}_px"] = rows
    return data, transform(T_world_device, shot.device[t])


@pytest.fixture
def unzipped(shot, tmp_path):
    folder = tmp_path / "603778748449547"
    for t in range(len(shot)):
        for v in range(4):
            shot.write(folder / f"frame{t:04d}_cam{v}.jpg", t, v)
        data, world = content(shot, t)
        (folder / f"frame{t:04d}.json").write_text(json.dumps(data))
        shot.world[t] = world
    return folder


def test_round_trip(unzipped, shot, check):
    (recording,) = recordings("egobody3m", unzipped.parent)
    check(recording, shot, LABELLED)
    assert recording.name == "603778748449547"
    upright = recording.labels.joints_head[0]
    assert abs(upright[1]).max() < 0.05  # the neck is the origin, and the head is not tilted


def test_zipped_round_trip(unzipped, shot, check, tmp_path):
    zipped = tmp_path / "zipped"
    zipped.mkdir()
    for part, suffix in (("images", ".jpg"), ("metadata", ".json")):
        with zipfile.ZipFile(zipped / f"{unzipped.name}.{part}.zip", "w") as archive:
            for path in sorted(unzipped.glob(f"*{suffix}")):
                archive.write(path, f"{unzipped.name}/{path.name}")
    (recording,) = recordings("egobody3m", zipped)
    check(recording, shot, LABELLED)


def test_missing_and_foreign_parts_are_named(unzipped, shot):
    frame = unzipped / "frame0003.json"
    data = json.loads(frame.read_text())
    bent = (np.array(data["world_from_headset_xf_cm"]) * 2.0).tolist()
    for match, changed in [
        ("key 'joint_positions_world_cm'", {"joint_positions_world_cm": None}),
        (r"shape \(3, 3\)", {"joint_positions_world_cm": np.eye(3).tolist()}),
        ("not a rigid transform", {"world_from_headset_xf_cm": bent}),
    ]:
        kept = {k: v for k, v in (data | changed).items() if v is not None}
        frame.write_text(json.dumps(kept))
        with pytest.raises(FileError, match=match):
            list(recordings("egobody3m", unzipped))
    for path in unzipped.glob("*.json"):
        path.unlink()
    with pytest.raises(FileError, match=r"neither ID\.metadata\.zip nor a folder"):
        list(recordings("egobody3m", unzipped))
