"""EgoBody3M: four cameras of a headset, a JSON file a frame with 26 joints in centimetres.

ID.images.zip and ID.metadata.zip, or the folder ID that both unzip to: frame0000_cam0.jpg ...
and frame0000.json {world_from_headset_xf_cm, joint_positions_world_cm (26, 3), y up,
projected_joint_positions_cam0_px (26, 3): x, y and depth in centimetres}. The transform maps the
headset's frame to the world, as its name says. Lenses and camera poses are fitted to the projected
joints, since the data set ships no calibration.

Source: facebookresearch/EgoBody3M (README).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_ORDER
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.fields import array
from egocap.datasets.lens_fit import fit_camera
from egocap.datasets.mounting import upright
from egocap.datasets.pictures import Picture, Tree, last_number
from egocap.datasets.recording import Labels, Recording, frame_times, inside_images, on_labels
from egocap.datasets.xr_egopose import Y_UP_TO_WORLD
from egocap.errors import FileError
from egocap.geometry import inverse, rigid, transform
from egocap.schema import parsed

CM = 0.01
RATE = 30.0  # Hz
CAMERAS = (0, 1, 2, 3)
NAMES = JOINT_ORDER["egobody3m"]
IN_FRONT_M = 0.02  # least depth of a joint whose pixel is used


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The sequences in a folder, zipped or not, or the one in an unzipped folder. A `rig` given is
    in the head frame of the labels' median posture.

    Raises FileError for a part missing or unknown.
    """
    if not root.is_dir():
        raise FileError(root, "no such folder")
    if any(root.glob("frame*.json")):
        return iter([_read(dataset, root.name, Tree(root), Tree(root), rig)])
    zipped = {path.name.split(".")[0] for path in root.glob("*.metadata.zip")}
    folders = {path.parent.name for path in root.glob("*/frame*.json")}
    if not zipped | folders:
        raise FileError(root, "neither ID.metadata.zip nor a folder ID with frame*.json")
    return (_read(dataset, n, *_trees(root, n), rig) for n in sorted(zipped | folders))


def _trees(root: Path, name: str) -> tuple[Tree, Tree]:
    """Metadata and images of a sequence."""
    if (root / name).is_dir():
        return Tree(root / name), Tree(root / name)
    return Tree(root / f"{name}.metadata.zip"), Tree(root / f"{name}.images.zip")


@dataclass(frozen=True, eq=False)
class _Frame:
    T_world_headset: Float[Array, "4 4"]
    world: Float[Array, "26 3"]
    projected: Float[Array, "4 26 3"]  # pixels, depth in metres


def _read(dataset: str, name: str, metadata: Tree, images: Tree, rig: Rig | None) -> Recording:
    files = {last_number(n): n for n in metadata.names("") if n.endswith(".json")}
    frames = tuple(sorted(n for n in files if n is not None))
    rows = [_frame(metadata, files[n]) for n in frames]
    if not rows:
        raise FileError(metadata.path, "no frame0000.json")
    T_world_headset = np.stack([row.T_world_headset for row in rows])
    world = np.stack([row.world for row in rows])
    projected = np.stack([row.projected for row in rows])
    device = transform(inverse(T_world_headset), world)
    T_head_headset = upright(*on_labels(device, NAMES, "egobody3m"))
    assert T_head_headset is not None, "all joints are labelled"
    pictures = tuple(tuple(images.picture(f"frame{n:04d}_cam{c}.jpg") for c in CAMERAS)
                     for n in frames)  # fmt: skip
    rig = rig or _rig(dataset, metadata, device, projected, pictures[0], T_head_headset)
    head, labelled = on_labels(transform(T_head_headset, device), NAMES, "egobody3m")
    in_front = projected[..., 2:] > IN_FRONT_M
    seen, there = on_labels(np.where(in_front, projected[..., :2], np.nan), NAMES, "egobody3m")
    T_world_head = rigid(Y_UP_TO_WORLD, np.zeros(3)) @ T_world_headset @ inverse(T_head_headset)
    labels = Labels(head, labelled, seen, there & inside_images(seen, rig), T_world_head)
    return Recording(dataset, name, rig, frame_times(frames, RATE), frames, pictures, labels)


def _frame(tree: Tree, name: str) -> _Frame:
    path = tree.where(name)
    data = parsed(tree.read(name), path)
    T = array(data, path, "world_from_headset_xf_cm", shape=(4, 4))
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise FileError(path, "not a rigid transform", key="world_from_headset_xf_cm")
    world = CM * array(data, path, "joint_positions_world_cm", shape=(len(NAMES), 3))
    keys = [f"projected_joint_positions_cam{c}_px" for c in CAMERAS]
    projected = np.stack([array(data, path, key, shape=(len(NAMES), 3)) for key in keys])
    return _Frame(rigid(R, CM * T[:3, 3]), world, projected * [1.0, 1.0, CM])


def _rig(
    dataset: str, tree: Tree, device: Float[Array, "T 26 3"],
    projected: Float[Array, "T 4 26 3"], pictures: tuple[Picture, ...],
    T_head_headset: Float[Array, "4 4"],
) -> Rig:  # fmt: skip
    mounts = []
    for c, picture in zip(CAMERAS, pictures, strict=True):
        height, width = picture.read().shape[:2]
        used = projected[:, c, :, 2] > IN_FRONT_M
        where = tree.where(f"projected_joint_positions_cam{c}_px")
        if used.sum() < 100:
            raise FileError(where, f"{used.sum()} joints in front of the camera",
                            valid="100 or more, to find its calibration")  # fmt: skip
        seen = projected[:, c][used]
        camera, T_camera_headset = fit_camera(
            device[used], seen[:, :2], seen[:, 2], (width, height), where
        )
        pose = T_head_headset @ inverse(T_camera_headset)
        mounts.append(Mount(f"cam{c}", camera, pose))
    return Rig(dataset, tuple(mounts), RATE)
