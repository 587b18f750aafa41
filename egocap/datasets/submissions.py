"""Predicted poses in the files that a data set's own evaluation reads.

UnrealEgo2 and UnrealEgo-RW have a benchmark server, SceneEgo an evaluation program: their formats
are as published. For the others no format is published; poses are written as the data set stores
its labels.
"""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_ORDER
from egocap.datasets.recording import Recording, on_joints
from egocap.datasets.unrealego import LAYOUTS
from egocap.datasets.xr_egopose import Y_UP_TO_WORLD
from egocap.errors import FileError, InputError
from egocap.files import write_atomically
from egocap.geometry import inverse, transform


class Prediction(NamedTuple):
    """Poses of one recording."""

    recording: Recording
    joints_head: Float[Array, "T 18 3"]  # metres, head frame of the recording's rig
    valid: Bool[Array, "T 18"]


class Format(NamedTuple):
    """How a data set's predictions are written."""

    suffix: str
    content: Callable[[list[Prediction]], bytes]


SERVER_FOLDERS = {
    "unrealego2": "UnrealEgoData2_test_pose",
    "unrealego-rw": "UnrealEgoData_rw_test_pose",
}


def write_submission(predictions: Iterable[Prediction], path: str | Path) -> None:
    """Write poses of one data set's recordings to a file in its format.

    Raises:
        InputError: nothing to write, several data sets, or a frame without a joint that the data
            set has.
        FileError: the file's name does not end as the format's.
    """
    found, path = list(predictions), Path(path)
    names = {prediction.recording.dataset for prediction in found}
    if len(names) != 1:
        raise InputError(f"a submission of {len(names)} data sets", valid="poses of one data set")
    (name,) = names
    form = FORMATS[name]
    if path.suffix != form.suffix:
        raise FileError(path, f"the format of {name} is {form.suffix}", valid=f"NAME{form.suffix}")
    write_atomically(path, form.content(found))


def _named(prediction: Prediction, points: Float[Array, "T 18 3"], table: str) -> Array:
    """Points on the data set's joints, all of those that have a label. Raises InputError."""
    known = np.where(prediction.valid[..., None], points, np.nan)
    names = JOINT_ORDER[table]
    found = on_joints(known, names, table)
    wanted = np.isfinite(on_joints(np.zeros((1, 18, 1)), names, table))[..., 0]
    absent = np.argwhere(~np.isfinite(found).all(-1) & wanted)
    if len(absent):
        row, joint = absent[0]
        frame = prediction.recording.frames[row]
        problem = f"{prediction.recording.name}: no {names[joint]} in frame {frame}"
        raise InputError(f"{problem} ({len(absent)} in all)", valid="every joint in every frame")
    return found


def _in_view(prediction: Prediction) -> Float[Array, "T 18 3"]:
    """Joints in the frame of the recording's first camera."""
    return transform(prediction.recording.rig.T_camera_head[0], prediction.joints_head)


def _archive(members: Mapping[str, object]) -> bytes:
    """A zip archive of JSON files; equal content gives equal bytes."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            archive.writestr(entry, json.dumps(content, indent=4), zipfile.ZIP_DEFLATED)
    return file.getvalue()


def _device_frames(predictions: list[Prediction]) -> bytes:
    """FOLDER/SEQUENCE/json/frame_N.json with {joint: [x, y, z]}, device frame, centimetres.

    Source: predict_pose.py of 3D-Human-Pose-Perception-from-Egocentric-Stereo-Videos.
    """
    members = {}
    for prediction in predictions:
        recording = prediction.recording
        layout = LAYOUTS[recording.dataset]
        folder = SERVER_FOLDERS.get(recording.dataset, f"{recording.dataset}_pose")
        assert recording.T_head_device is not None
        points = 100.0 * transform(inverse(recording.T_head_device), prediction.joints_head)
        named = _named(prediction, points, layout.joints)
        for n, pose in zip(recording.frames, named.tolist(), strict=True):
            place = f"{folder}/{recording.name}/json/frame_{n}.json"
            members[place] = dict(zip(JOINT_ORDER[layout.joints], pose, strict=True))
    return _archive(members)


def _fisheye_frames(predictions: list[Prediction]) -> bytes:
    """SEQUENCE/json/N.json as xR-EgoPose's labels: names and pts3d_fisheye (3, J), centimetres."""
    members = {}
    names = [{"name": f"mixamorig:{name}"} for name in JOINT_ORDER["ego4view"]]
    for prediction in predictions:
        points = _named(prediction, 100.0 * _in_view(prediction), "ego4view")
        for n, pose in zip(prediction.recording.frames, points, strict=True):
            place = f"{prediction.recording.name}/json/{n:06d}.json"
            members[place] = {"joints": names, "pts3d_fisheye": pose.T.tolist()}
    return _archive(members)


def _world_frames(predictions: list[Prediction]) -> bytes:
    """ID/frameN.json as EgoBody3M's labels; null for joints that no label gives."""
    members = {}
    for prediction in predictions:
        labels = prediction.recording.labels
        assert labels is not None and labels.T_world_head is not None
        world = 100.0 * transform(labels.T_world_head, prediction.joints_head) @ Y_UP_TO_WORLD
        named = _named(prediction, world, "egobody3m")
        for n, pose in zip(prediction.recording.frames, named, strict=True):
            rows = [row.tolist() if np.isfinite(row).all() else None for row in pose]
            content = {"frame_index": n, "joint_positions_world_cm": rows}
            members[f"{prediction.recording.name}/frame{n:04d}.json"] = content
    return _archive(members)


def _list_of_poses(predictions: list[Prediction]) -> bytes:
    """A pickled list of (15, 3) arrays, camera frame, metres, in the order of the frames.

    Source: test.py of SceneEgo.
    """
    poses = [_named(p, _in_view(p), "mo2cap2").astype(np.float32) for p in predictions]
    return pickle.dumps([pose for sequence in poses for pose in sequence], protocol=4)


def _mat(predictions: list[Prediction]) -> bytes:
    """A MAT file with pose_pred (N, 15, 3) in millimetres, camera frame, as pose_gt."""
    from scipy.io import savemat

    poses = [_named(p, 1000.0 * _in_view(p), "mo2cap2") for p in predictions]
    file = io.BytesIO()
    savemat(file, {"pose_pred": np.concatenate(poses)})
    return file.getvalue()


def _rows(predictions: list[Prediction]) -> bytes:
    """Rows of frame number and 18 points in cam0's frame, millimetres, as dataset3D.mddd."""
    lines = ["Skeletool marker data V1.0"]
    for prediction in predictions:
        points = _named(prediction, 1000.0 * _in_view(prediction), "egocap")
        for n, pose in zip(prediction.recording.frames, points, strict=True):
            lines.append(" ".join([str(n), *(f"{x:.6f}" for x in pose.ravel())]))
    return ("\n".join(lines) + "\n").encode()


FORMATS: Mapping[str, Format] = {
    **dict.fromkeys(LAYOUTS, Format(".zip", _device_frames)),
    **dict.fromkeys(("sceneego", "egopw", "egowholemocap"), Format(".pkl", _list_of_poses)),
    "xr-egopose": Format(".zip", _fisheye_frames),
    "egobody3m": Format(".zip", _world_frames),
    "mo2cap2": Format(".mat", _mat),
    "egocap": Format(".mddd", _rows),
}
