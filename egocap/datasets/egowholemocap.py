"""EgoWholeMocap (EgoWholeBody): one pickle for all sequences of a set, joints in metres.

{"data_list": {IDENTITY: {SEQUENCE: [{img_path, renderpeople_local_joints (73, 3),
mo2cap2_local_joints (15, 3), ...}]}}}, or in an older version the list alone; `img_path` is
relative to the pickle's folder, joints are in the camera's OpenCV frame. Hands and face beyond our
labels, depth and segmentation are not read.

Source: jianwang-mpi/egowholemocap (mmpose/datasets/datasets/egocentric/renderpeople_mixamo*.py).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from egocap.body.joint_names import JOINT_ORDER
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.calibration import find_camera
from egocap.datasets.fields import array, item
from egocap.datasets.mounting import looking_down
from egocap.datasets.pictures import Picture, last_number
from egocap.datasets.plain_pickle import load_plain_pickle
from egocap.datasets.recording import Labels, Recording, frame_times, on_labels
from egocap.errors import FileError
from egocap.geometry import transform

RATE = 30.0  # Hz
T_HEAD_CAMERA = looking_down(0.20, 0.15)
CALIBRATION = ("fisheye.calibration_01_12.json", "egowholemocap_fisheye.json")


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The sequences of the pickles in a folder, or of one pickle.

    Raises FileError for a part missing or unknown.
    """
    files = [root] if root.is_file() else sorted(root.glob("*.pkl"))
    if not files:
        raise FileError(root, "no .pkl file", valid="the folder of the labels, or one label file")
    for path in files:
        for name, entries in _sequences(path):
            yield _recording(dataset, path, name, entries, rig)


def _sequences(path: Path) -> Iterator[tuple[str, list[Any]]]:
    """Names and entries of the sequences of one pickle."""
    data = item(load_plain_pickle(path), path, "data_list")
    if isinstance(data, dict):
        for identity, sequences in data.items():
            if not isinstance(sequences, dict):
                raise FileError(path, "not a table of sequences", key=f"data_list.{identity}")
            yield from ((f"{identity}/{name}", entries) for name, entries in sequences.items())
        return
    if not isinstance(data, list):
        raise FileError(path, f"holds a {type(data).__name__}", key="data_list")
    groups: dict[str, list[Any]] = {}
    for entry in data:
        folder = str(item(entry, path, "img_path")).replace("\\", "/").rpartition("/")[0]
        groups.setdefault(folder, []).append(entry)
    yield from groups.items()


def _recording(
    dataset: str, path: Path, name: str, entries: list[Any], rig: Rig | None
) -> Recording:
    if not isinstance(entries, list) or not entries:
        raise FileError(path, "no list of frames", key=f"data_list.{name}")
    images = [str(item(entry, path, "img_path")).replace("\\", "/") for entry in entries]
    order = sorted(range(len(images)), key=lambda i: (last_number(images[i]) or 0, images[i]))
    frames = tuple(last_number(images[i]) or 0 for i in order)
    if len(set(frames)) < len(frames):
        raise FileError(path, "an image is listed twice", key=f"data_list.{name}")
    key, table = _skeleton(entries[0])
    names = JOINT_ORDER[table]
    points = np.stack([array(entries[i], path, key, shape=(len(names), 3)) for i in order])
    if rig is None:
        camera = find_camera(path.parent, CALIBRATION, "the repository of EgoWholeMocap")
        rig = Rig(dataset, (Mount("camera", camera, T_HEAD_CAMERA),), RATE)
    head, labelled = on_labels(transform(rig.T_head_camera[0], points), names, table)
    no_pixels = np.zeros((len(order), 1, 18, 2))
    labels = Labels(head, labelled, no_pixels, np.zeros(no_pixels.shape[:3], bool))
    pictures = tuple((Picture(path.parent / images[i]),) for i in order)
    return Recording(dataset, name, rig, frame_times(frames, RATE), frames, pictures, labels)


def _skeleton(entry: Any) -> tuple[str, str]:
    """Key of the joints, and their table: with fingers in the present version of the labels."""
    key = "renderpeople_local_joints"
    if np.shape(entry.get(key, ())) == (len(JOINT_ORDER["renderpeople"]), 3):
        return key, "renderpeople"
    return "mo2cap2_local_joints", "mo2cap2"
