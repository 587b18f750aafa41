"""xR-EgoPose: one camera below a headset, a JSON file a frame with joints in centimetres.

.../CHARACTER/ENVIRONMENT/cam_down/{json,rgba}: `pts3d_fisheye` (3, J) in the camera's OpenCV frame,
`pts2d_fisheye` (2, J) in pixels, `joints` with names and world positions (y up), `action`. The lens
is fitted to these points, since the data set ships no calibration.

Source: facebookresearch/xR-EgoPose (dataset/mocap.py, README).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Mount, Rig
from egocap.datasets.fields import array, folders_with, item
from egocap.datasets.lens_fit import fit_lens
from egocap.datasets.mounting import head_poses, looking_down
from egocap.datasets.pictures import Picture, numbered
from egocap.datasets.recording import Labels, Recording, frame_times, inside_images, on_labels
from egocap.errors import FileError
from egocap.geometry import transform
from egocap.schema import read_json

CM = 0.01
RATE = 30.0  # Hz
T_HEAD_CAMERA = looking_down(0.13, 0.06)
Y_UP_TO_WORLD = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The sequences at or below a folder. Raises FileError for a part missing or unknown."""
    for folder in folders_with(root, ("rgba",)):
        yield _read(dataset, root, folder, rig)


def _read(dataset: str, root: Path, folder: Path, rig: Rig | None) -> Recording:
    images, files = numbered(folder / "rgba"), numbered(folder / "json", (".json",))
    if not images or images.keys() != files.keys():
        problem = f"{len(images)} images in rgba, {len(files)} files in json"
        raise FileError(folder, problem, valid="one of each a frame")
    pictures = tuple((Picture(path),) for path in images.values())
    contents = [_frame(path) for path in files.values()]
    names = contents[0][0]
    for path, (others, *_) in zip(files.values(), contents, strict=True):
        if others != names:
            raise FileError(path, "has other joints than the first frame", key="joints")
    points, pixels, world = (np.stack(column) for column in list(zip(*contents, strict=True))[1:4])
    in_front = points[..., 2] > 0.0
    rig = rig or _rig(dataset, points[in_front], pixels[in_front], pictures[0][0], folder)
    joints = transform(rig.T_head_camera[0], points)
    head, labelled = on_labels(joints, names, "ego4view")
    seen, there = on_labels(np.where(in_front[..., None], pixels, np.nan), names, "ego4view")
    seen, there = seen[:, None], there[:, None]
    labels = Labels(
        head, labelled, seen, there & inside_images(seen, rig), head_poses(joints, world)
    )
    actions = {action for *_, action in contents}
    name = folder.relative_to(root).as_posix() if folder != root else folder.name
    frames = tuple(images)
    return Recording(
        dataset, name, rig, frame_times(frames, RATE), frames, pictures, labels,
        category=actions.pop() if len(actions) == 1 else "",
    )  # fmt: skip


def _frame(path: Path) -> tuple[list[str], Array, Array, Array, str]:
    """Names, points [m], pixels and world positions [m] of a frame's joints, and its action."""
    data = read_json(path)
    listed: list[Any] = item(data, path, "joints")
    if not isinstance(listed, list):
        raise FileError(path, "not a list", key="joints")
    names = [str(item(joint, path, "name")).removeprefix("mixamorig:") for joint in listed]
    count = len(names)
    points = CM * array(data, path, "pts3d_fisheye", shape=(3, count)).T
    pixels = array(data, path, "pts2d_fisheye", shape=(2, count)).T
    world = np.stack([array(joint, path, "trans", shape=(3,)) for joint in listed])
    return names, points, pixels, CM * world @ Y_UP_TO_WORLD.T, str(data.get("action", ""))


def _rig(
    dataset: str,
    points: Float[Array, "N 3"],
    pixels: Float[Array, "N 2"],
    picture: Picture,
    folder: Path,
) -> Rig:
    height, width = picture.read().shape[:2]
    camera = fit_lens(points, pixels, (width, height), folder / "json")
    return Rig(dataset, (Mount("down", camera, T_HEAD_CAMERA),), RATE)
