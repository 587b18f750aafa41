"""A track as SMPL-X pose parameters, in the layout of AMASS (npz).

Rotations are retargeted by body segment, which needs no licensed model: the pose of a mean body
(`betas` 0) whose segments are oriented as the tracked ones. `poses` is (T, 165), of which the first
66 values are SMPL's and SMPL-H's too; hands, jaw and eyes are at rest. `trans` is the place of the
pelvis; a model puts its own rest pelvis there, which is to be taken off for an exact place. Metres,
z up, x forward.

Source: Loper et al. 2015, "SMPL"; Pavlakos et al. 2019, "SMPL-X" (order of joints, T pose with y
up and z forward); Mahmood et al. 2019, "AMASS" (names of the arrays).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import POINT_INDEX
from egocap.data.bvh import TO_FILE, body_rotations, frame_time, root_position
from egocap.data.resampling import evenly
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.files import write_npz
from egocap.geometry import axis_angle, unit

JOINTS: tuple[tuple[str, str | None, str], ...] = (
    ("pelvis", None, "lower_spine"), ("left_hip", "pelvis", "left_hip"),
    ("right_hip", "pelvis", "right_hip"), ("spine1", "pelvis", "spine1"),
    ("left_knee", "left_hip", "left_knee"), ("right_knee", "right_hip", "right_knee"),
    ("spine2", "spine1", "spine2"), ("left_ankle", "left_knee", "left_ankle"),
    ("right_ankle", "right_knee", "right_ankle"), ("spine3", "spine2", "upper_spine"),
    ("left_foot", "left_ankle", "left_ankle"), ("right_foot", "right_ankle", "right_ankle"),
    ("neck", "spine3", "neck"), ("left_collar", "spine3", "left_clavicle"),
    ("right_collar", "spine3", "right_clavicle"), ("head", "neck", "skull"),
    ("left_shoulder", "left_collar", "left_shoulder"),
    ("right_shoulder", "right_collar", "right_shoulder"),
    ("left_elbow", "left_shoulder", "left_elbow"),
    ("right_elbow", "right_shoulder", "right_elbow"),
    ("left_wrist", "left_elbow", "left_wrist"), ("right_wrist", "right_elbow", "right_wrist"),
)  # fmt: skip
"""Joints of the model's body in its order, their parents, and the tracked bodies they turn."""
_ARM = ("shoulder", "elbow", "wrist")
_POSE = 165  # SMPL-X: 22 joints of the body, jaw, eyes and 30 of the hands, three values each


def write_smpl(path: Path, track: Track) -> None:
    """Write a track as SMPL-X pose parameters, atomically.

    Raises InputError for a track without skeleton or whose times do not increase, for
    another suffix, and as `egocap.files.disk_errors`.
    """
    if path.suffix != ".npz":
        raise InputError(f"cannot write '{path.name}'", valid="a name that ends in .npz")
    if track.offsets is None:
        raise InputError("the track does not hold its skeleton", valid="a track of schema 2")
    track = evenly(track)
    body = smpl_pose(track)
    step = frame_time(track)
    poses = np.zeros((len(body), _POSE))
    poses[:, : body.shape[1]] = body
    write_npz(
        path, gender="neutral", surface_model_type="smplx",
        mocap_frame_rate=1.0 / step, mocap_time_length=step * len(body),
        trans=root_position(track) @ TO_FILE, poses=poses, betas=np.zeros(16),
        root_orient=body[:, :3], pose_body=body[:, 3:], pose_hand=poses[:, 75:],
        pose_jaw=poses[:, 66:69], pose_eye=poses[:, 69:75],
    )  # fmt: skip


def smpl_pose(track: Track) -> Float[Array, "T 66"]:
    """Rotation vectors of the model's 22 body joints against their parents, rad."""
    from scipy.spatial.transform import Rotation

    turned = {name: R @ TO_FILE.T for name, R in _segments(track).items()}
    columns = []
    for name, parent, _ in JOINTS:
        R = turned[name] if parent is None else np.swapaxes(turned[parent], -1, -2) @ turned[name]
        columns.append(Rotation.from_matrix(R).as_rotvec())
    return np.concatenate(columns, axis=1)


def _segments(track: Track) -> dict[str, Float[Array, "T 3 3"]]:
    """Rotations of the model's segments from its T pose, in the project's axes."""
    from scipy.spatial.transform import Rotation

    bodies = body_rotations(track)
    pelvis = Rotation.from_matrix(bodies["lower_spine"])
    bend = (pelvis.inv() * Rotation.from_matrix(bodies["upper_spine"])).as_rotvec()
    for i in (1, 2):
        bodies[f"spine{i}"] = (pelvis * Rotation.from_rotvec(i / 3 * bend)).as_matrix()
    lowered = {side: _lowered(track, side) for side in ("left", "right")}
    found = {}
    for name, _, body in JOINTS:
        side, _, part = name.partition("_")
        found[name] = bodies[body] @ lowered[side] if part in _ARM else bodies[body]
    return found


def _lowered(track: Track, side: str) -> Float[Array, "3 3"]:
    """Rotation of an arm from sideways, as in the T pose, to hanging as in the track's rest."""
    hanging = unit(np.asarray(track.offsets)[POINT_INDEX[f"{side}_elbow"]])
    sideways = np.array([0.0, 1.0 if side == "left" else -1.0, 0.0])
    axis = np.cross(sideways, hanging)
    return axis_angle(unit(axis), float(np.arctan2(np.linalg.norm(axis), sideways @ hanging)))
