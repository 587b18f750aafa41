"""SMPL-X pose parameters, posed by scipy's rotations on a T-shaped figure of the model's layout."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import LABEL_INDEX
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.export.smpl import JOINTS, write_smpl
from egocap.geometry import axis_angle
from tests.egocap.conftest import make_motion

# Directions of bones in the model's T pose: x left, y up, z forward.
T_POSE = {
    ("left_shoulder", "left_elbow"): (1, 0, 0), ("right_shoulder", "right_elbow"): (-1, 0, 0),
    ("left_elbow", "left_wrist"): (1, 0, 0), ("right_elbow", "right_wrist"): (-1, 0, 0),
    ("left_hip", "left_knee"): (0, -1, 0), ("right_hip", "right_knee"): (0, -1, 0),
    ("left_knee", "left_ankle"): (0, -1, 0), ("right_knee", "right_ankle"): (0, -1, 0),
}  # fmt: skip


@pytest.fixture(scope="module")
def moved():
    """A moving person whose head turns and travels."""
    made = make_motion(frames=40)
    frames = len(made.angles)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, :3, :3] = axis_angle(np.array([0.6, 0.0, 0.8]), np.linspace(0.0, 2.0, frames))
    T[:, :3, 3] = np.linspace([0.0, 0.0, 1.6], [2.0, 1.0, 1.4], frames)
    world = np.einsum("tij,tnj->tni", T[:, :3, :3], made.joints) + T[:, None, :3, 3]
    still = np.zeros(frames)
    return Track(
        np.arange(frames) / 30.0, made.angles, made.joints, still, still == 0, still, 0.0, {},
        offsets=np.array(made.person.offsets), T_world_head=T, joints_world=world,
    )  # fmt: skip


def posed(found):
    """World rotations of the model's joints: the chain of local rotations."""
    local = found["poses"].reshape(len(found["poses"]), -1, 3)
    names = [name for name, _, _ in JOINTS]
    world = {}
    for i, (name, parent, _) in enumerate(JOINTS):
        R = Rotation.from_rotvec(local[:, i])
        world[name] = R if parent is None else world[parent] * R
        assert parent is None or names.index(parent) < i
    return world


def test_bones_point_where_the_track_has_them(moved, tmp_path):
    write_smpl(tmp_path / "t.npz", moved)
    with np.load(tmp_path / "t.npz") as found:
        world = posed(found)
    for (upper, lower), direction in T_POSE.items():
        bone = np.diff(moved.joints_world[:, [LABEL_INDEX[upper], LABEL_INDEX[lower]]], axis=1)
        bone = bone[:, 0] / np.linalg.norm(bone[:, 0], axis=-1, keepdims=True)
        off = np.rad2deg(np.arccos(np.sum(world[upper].apply(direction) * bone, -1).clip(-1, 1)))
        # A person's legs are not quite vertical at rest, as the model's are not.
        assert off.max() < (0.5 if "shoulder" in upper or "elbow" in upper else 5.0), (upper, off)


def test_the_pelvis_stands_between_the_hips_and_faces_forward(moved, tmp_path):
    write_smpl(tmp_path / "t.npz", moved)
    with np.load(tmp_path / "t.npz") as found:
        facing = Rotation.from_rotvec(found["root_orient"]).apply([0.0, 0.0, 1.0])
        left = Rotation.from_rotvec(found["root_orient"]).apply([1.0, 0.0, 0.0])
        place = found["trans"]
    hips = moved.joints_world[:, [LABEL_INDEX["left_hip"], LABEL_INDEX["right_hip"]]]
    across = hips[:, 0] - hips[:, 1]
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    assert (np.sum(left * across, -1) > 0.999).all()
    assert np.linalg.norm(place - hips.mean(1), axis=-1).max() < 0.2
    ahead = moved.T_world_head[0, :3, 0]
    assert facing[0] @ ahead > 0.5


def test_layout_is_that_of_amass(moved, tmp_path):
    write_smpl(tmp_path / "t.npz", moved)
    with np.load(tmp_path / "t.npz") as found:
        shapes = {name: found[name].shape for name in found.files}
        assert str(found["surface_model_type"]) == "smplx" and str(found["gender"]) == "neutral"
        assert found["mocap_frame_rate"] == pytest.approx(30.0)
        assert (found["poses"][:, :3] == found["root_orient"]).all()
        assert (found["poses"][:, 3:66] == found["pose_body"]).all()
    frames = len(moved.times)
    assert shapes["poses"] == (frames, 165) and shapes["trans"] == (frames, 3)
    assert shapes["pose_hand"] == (frames, 90) and shapes["pose_eye"] == (frames, 6)
    assert shapes["betas"] == (16,)


def test_another_suffix_is_refused(moved, tmp_path):
    with pytest.raises(InputError, match=r"\.npz"):
        write_smpl(tmp_path / "t.bvh", moved)
