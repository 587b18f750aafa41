"""Mo2Cap2: HDF5 chunks of single training images, and two test sequences with poses in a MAT file.

mo2cap2_chunk_*.hdf5: `Images` (N, 3, 256, 256), the middle 1024 x 1024 pixels at a quarter;
`Annot2D` (N, 15, 2) and `Annot3D` (N, 15, 3), millimetres in the camera's OpenCV frame. Rows are
single images, not a motion. NAME/*.jpg with NAME_gt.mat: `pose_gt` (N, 15, 3) in millimetres, in a
frame unrelated to the camera's, so that only aligned errors mean anything.

Source: the data set's download script and loaders in public code (jianwang-mpi/egowholemocap).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_ORDER
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.calibration import find_camera
from egocap.datasets.fields import array
from egocap.datasets.mounting import looking_down
from egocap.datasets.pictures import SUFFIXES, Picture, last_number, open_hdf5
from egocap.datasets.recording import Labels, Recording, frame_times, inside_images, on_labels
from egocap.errors import FileError
from egocap.geometry import transform

MM = 0.001
RATE = 30.0  # Hz
NAMES = JOINT_ORDER["mo2cap2"]
T_HEAD_CAMERA = looking_down(0.20, 0.15)
CALIBRATION = ("fisheye.calibration.json",)
CROP = 128  # columns cut on each side of a full image
SMALL = 256  # pixels of a training image
SHIFT = np.array([33.0, 0.0])  # of Annot2D against the training image, as public loaders use it


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """Chunks and test sequences at or below a folder, or of one file.

    Raises FileError for a part missing or unknown, MachineError without h5py.
    """
    if not root.exists():
        raise FileError(root, "no such file or folder")
    files = [root] if root.is_file() else sorted(root.rglob("*"))
    for path in files:
        if path.name.startswith("mo2cap2_chunk_") and path.suffix in (".hdf5", ".h5"):
            yield _chunk(dataset, path, rig)
        elif path.name.endswith("_gt.mat"):
            yield _test_sequence(dataset, path, rig)


def small_camera(camera: Camera) -> Camera:
    """The camera of the training images: the middle of the full image, at a quarter."""
    (x, y), width = camera.centre, camera.width - 2 * CROP
    return replace(camera, width=width, centre=(x - CROP, y)).resized(SMALL, SMALL)


def full_rig(dataset: str, folder: Path) -> Rig:
    """The rig of the full images, from the calibration beside the data."""
    camera = find_camera(folder, CALIBRATION, "the repository of SceneEgo or GlobalEgoMocap")
    return Rig(dataset, (Mount("camera", camera, T_HEAD_CAMERA),), RATE)


def _chunk(dataset: str, path: Path, rig: Rig | None) -> Recording:
    rig = rig or full_rig(dataset, path.parent)
    mount = rig.mounts[0]
    rig = replace(rig, mounts=(replace(mount, camera=small_camera(mount.camera)),))
    with open_hdf5(path) as file:
        content = {key: _dataset(file, path, key) for key in ("Annot2D", "Annot3D", "Images")}
        points = MM * array(content, path, "Annot3D", shape=(None, 15, 3))
        pixels = array(content, path, "Annot2D", shape=(len(points), 15, 2)) - SHIFT
        shape = content["Images"].shape
    if shape != (len(points), 3, SMALL, SMALL):
        valid = str((len(points), 3, SMALL, SMALL))
        raise FileError(path, f"has shape {shape}", key="Images", valid=valid)
    head, labelled = on_labels(transform(mount.T_head_camera, points), NAMES, "mo2cap2")
    seen, there = on_labels(pixels[:, None], NAMES, "mo2cap2")
    labels = Labels(head, labelled, seen, there & inside_images(seen, rig))
    frames = tuple(range(len(points)))
    pictures = tuple((Picture(path, "Images", row),) for row in frames)
    return Recording(dataset, path.stem, rig, frame_times(frames, RATE), frames, pictures, labels)


def _dataset(file: Any, path: Path, key: str) -> Any:
    """A data set of an HDF5 file: annotations as arrays, images unread."""
    if key not in file:
        raise FileError(path, "missing; another version of the data set?", key=key, valid=file)
    return file[key] if key == "Images" else file[key][:]


def _test_sequence(dataset: str, path: Path, rig: Rig | None) -> Recording:
    folder = path.with_name(path.name.removesuffix("_gt.mat"))
    images = sorted(p for p in _images(folder) if p.suffix.lower() in SUFFIXES)
    poses = read_poses(path)
    if not images or len(images) > len(poses):
        raise FileError(folder, f"{len(images)} images, {len(poses)} poses in {path.name}",
                        valid="one image or more, and a pose for each")  # fmt: skip
    _refuse_gaps(images)
    rig = rig or full_rig(dataset, folder)
    head, labelled = on_labels(poses[: len(images)], NAMES, "mo2cap2")
    T = len(images)
    labels = Labels(head, labelled, np.zeros((T, 1, 18, 2)), np.zeros((T, 1, 18), bool))
    frames = tuple(range(T))
    pictures = tuple((Picture(image),) for image in images)
    times = frame_times(frames, RATE)
    return Recording(
        dataset, folder.name, rig, times, frames, pictures, labels, known_frame=False
    )  # fmt: skip


def read_poses(path: Path) -> Float[Array, "N 15 3"]:
    """`pose_gt` of a MAT file, in metres. Raises FileError."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, variable_names=["pose_gt"])
    except (OSError, ValueError, TypeError, NotImplementedError, MatReadError) as error:
        raise FileError(path, f"not a MAT file of version 5: {error}") from None
    return MM * array(content, path, "pose_gt", shape=(None, 15, 3))


def _images(folder: Path) -> list[Path]:
    """Images of a test sequence, in its folder or in imgs inside."""
    inside = folder / "imgs" if (folder / "imgs").is_dir() else folder
    if not inside.is_dir():
        raise FileError(folder, "no such folder of images", valid="beside its _gt.mat")
    return list(inside.iterdir())


def _refuse_gaps(images: list[Path]) -> None:
    """Poses are matched by order, so a missing image would shift all after it."""
    numbers = [last_number(path.name) for path in images]
    for path, before, after in zip(images[1:], numbers[:-1], numbers[1:], strict=True):
        if before is not None and after is not None and after % 10000 != (before + 1) % 10000:
            raise FileError(path, f"follows image {before}: images in between are missing")
