"""SceneEgo and EgoPW: one camera on a helmet, poses of 15 joints in metres in a pickle a sequence.

SceneEgo: `annotation.pkl` or `local_pose_gt.pkl`, a list of {ext_id, ego_pose_gt (15, 3) in the
camera's OpenCV frame, ext_pose_gt in the studio (y up), image_name, ...}, images in `imgs`, and
`syn.json` {ego, ext} to find an image by its ext_id. EgoPW: `pseudo_gt.pkl`, a list of {image_name,
optimized_local_pose (15, 3), joints_2d (15, 2)}: poses fitted to two views, not measured.

Source: jianwang-mpi/SceneEgo (README, dataset/test_dataset.py), jianwang-mpi/egowholemocap.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_ORDER
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.calibration import find_camera
from egocap.datasets.fields import array, folders_with, item
from egocap.datasets.mounting import head_poses, looking_down
from egocap.datasets.pictures import Picture, last_number
from egocap.datasets.plain_pickle import load_plain_pickle
from egocap.datasets.recording import Labels, Recording, frame_times, inside_images, on_labels
from egocap.datasets.xr_egopose import Y_UP_TO_WORLD
from egocap.errors import FileError
from egocap.geometry import transform
from egocap.schema import read_json

log = logging.getLogger(__name__)

RATE = 25.0  # Hz
NAMES = JOINT_ORDER["mo2cap2"]
T_HEAD_CAMERA = looking_down(0.35, 0.12)
FILES = {
    "sceneego": ("annotation.pkl", "local_pose_gt.pkl"),
    "egopw": ("pseudo_gt.pkl",),
}
CALIBRATIONS = {
    "sceneego": ("fisheye.calibration_05_08.json", "fisheye.calibration_01_12.json"),
    "egopw": ("fisheye.calibration.json",),
}


@dataclass(frozen=True, eq=False)
class _Pose:
    """One annotated image."""

    image: Path
    joints: Float[Array, "15 3"]
    world: Float[Array, "15 3"] | None = None
    pixels: Float[Array, "15 2"] | None = None


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The sequences at or below a folder. Raises FileError for a part missing or unknown."""
    for folder in folders_with(root, FILES[dataset]):
        path = next(folder / n for n in FILES[dataset] if (folder / n).is_file())
        poses = list(_poses(path, load_plain_pickle(path)))
        used = [pose for pose in poses if pose.image.is_file()]
        if not used:
            raise FileError(folder / "imgs", f"has none of the {len(poses)} annotated images")
        if len(used) < len(poses):
            log.warning("%s: %d annotated images are missing", folder, len(poses) - len(used))
        yield _recording(dataset, root, folder, used, rig)


def _poses(path: Path, data: Any) -> Iterator[_Pose]:
    if not isinstance(data, list) or not data:
        raise FileError(path, f"holds a {type(data).__name__}", valid="a list of annotations")
    for entry in data:
        if not isinstance(entry, dict):
            raise FileError(path, f"an annotation is a {type(entry).__name__}", valid="a dict")
        if path.name == "pseudo_gt.pkl":
            name = entry.get("image_name", entry.get("image_path"))
            if name is None:
                item(entry, path, "image_name")
            joints = array(entry, path, "optimized_local_pose", shape=(15, 3))
            pixels = (
                array(entry, path, "joints_2d", shape=(15, 2)) if "joints_2d" in entry else None
            )
            yield _Pose(path.parent / "imgs" / _base(name), joints, pixels=pixels)
        elif item(entry, path, "ego_pose_gt") is not None:
            joints = array(entry, path, "ego_pose_gt", shape=(15, 3))
            given = entry.get("ext_pose_gt") is not None
            world = array(entry, path, "ext_pose_gt", shape=(15, 3)) if given else None
            yield _Pose(path.parent / "imgs" / _image_name(entry, path), joints, world)


def _base(name: Any) -> str:
    """File name of a path of any operating system."""
    return str(name).replace("\\", "/").rpartition("/")[2]


def _image_name(entry: dict[str, Any], path: Path) -> str:
    if entry.get("image_name") is not None:
        return _base(entry["image_name"])
    sync = path.with_name("syn.json")
    offsets = read_json(sync)
    first = array(offsets, sync, "ego", shape=()) - array(offsets, sync, "ext", shape=())
    return f"img_{int(array(entry, path, 'ext_id', shape=()) + first):06d}.jpg"


def _recording(
    dataset: str, root: Path, folder: Path, poses: list[_Pose], rig: Rig | None
) -> Recording:
    poses = sorted(poses, key=lambda pose: (last_number(pose.image.name) or 0, pose.image.name))
    frames = tuple(last_number(pose.image.name) or 0 for pose in poses)
    if len(set(frames)) < len(frames):
        raise FileError(folder, "an image is annotated twice")
    if rig is None:
        camera = find_camera(folder, CALIBRATIONS[dataset], "the repository of SceneEgo's code")
        rig = Rig(dataset, (Mount("camera", camera, T_HEAD_CAMERA),), RATE)
    joints = transform(rig.T_head_camera[0], np.stack([pose.joints for pose in poses]))
    head, labelled = on_labels(joints, NAMES, "mo2cap2")
    unknown = np.full((15, 2), np.nan)
    pixels = np.stack([unknown if p.pixels is None else p.pixels for p in poses])[:, None]
    seen, there = on_labels(pixels, NAMES, "mo2cap2")
    world = [pose.world for pose in poses if pose.world is not None]
    T_world_head = None
    if len(world) == len(poses):
        T_world_head = head_poses(joints, np.stack(world) @ Y_UP_TO_WORLD.T)
    labels = Labels(head, labelled, seen, there & inside_images(seen, rig), T_world_head)
    name = folder.relative_to(root).as_posix() if folder != root else folder.name
    pictures = tuple((Picture(pose.image),) for pose in poses)
    return Recording(dataset, name, rig, frame_times(frames, RATE), frames, pictures, labels)
