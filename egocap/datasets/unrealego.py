"""UnrealEgo, UnrealEgo2, UnrealEgo-RW, Ego4View-Syn and Ego4View-RW: one layout, five versions.

A sequence is a folder of images a camera and a JSON file a frame with the joints in centimetres:
`camera_*_pts3d` in each camera's OpenCV frame, `camera_*_pts2d` in pixels, `device_pts3d` in the
device's frame (UnrealEgo itself: the mean of both cameras'), and their place in the world.

Source: the data sets' READMEs and code (hiroyasuakada/UnrealEgo,
3D-Human-Pose-Perception-from-Egocentric-Stereo-Videos, EgoRear).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_ORDER
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.calibration import find_camera
from egocap.datasets.fields import array, folders_with, item
from egocap.datasets.mounting import TOLERANCE_M, head_poses, looking_down, rigid_fit
from egocap.datasets.pictures import Picture, numbered
from egocap.datasets.recording import (
    Labels,
    Recording,
    frame_times,
    inside_images,
    on_labels,
)
from egocap.errors import FileError
from egocap.geometry import rigid, transform
from egocap.schema import read_json

CM = 0.01
RATE = 25.0  # Hz
UNREAL_TO_WORLD = CM * np.array([1.0, -1.0, 1.0])  # from left-handed Unreal units


@dataclass(frozen=True)
class Layout:
    """What differs between the versions."""

    joints: str  # a key of `joint_names.JOINT_ORDER`
    json: str  # folder of the frames' JSON files
    images: str  # folder of the cameras' image folders
    forward: float  # metres of the device in front of the neck
    up: float
    to_world: Any  # factors from `trans` to metres with z up
    trans: str = "trans"
    calibrations: tuple[str, ...] = ("{camera}.json",)  # names of their files
    baseline: float | None = None  # metres between parallel cameras, to read frames without JSON


_EYEGLASSES = {
    "joints": "unrealego", "json": "json", "images": "fisheye_final_image", "forward": 0.14,
    "up": 0.10, "to_world": UNREAL_TO_WORLD, "baseline": 0.12,
    "calibrations": ("{camera}.json", "fisheye_calibration_UEP.json"),
}  # fmt: skip
_HEADSET = {"joints": "ego4view", "images": "fisheye_rgb", "forward": 0.20, "up": 0.12}
LAYOUTS = {
    "unrealego": Layout(**_EYEGLASSES),
    "unrealego2": Layout(**_EYEGLASSES),
    "unrealego-rw": Layout("ego4view", "json", "fisheye_final_image", 0.14, 0.10, np.full(3, CM)),
    "ego4view-syn": Layout(
        **_HEADSET, json="json_smplx_gendered", to_world=np.ones(3), trans="trans_blender"
    ),
    "ego4view-rw": Layout(**_HEADSET, json="json_smplx", to_world=np.full(3, CM)),
}


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The sequences at or below a folder. `rig` replaces the data set's cameras and their mounting.

    Raises FileError for a part that is missing or of another version.
    """
    layout = LAYOUTS[dataset]
    for folder in folders_with(root, (layout.images,)):
        yield _read(dataset, layout, root, folder, rig)


def _read(dataset: str, layout: Layout, root: Path, folder: Path, rig: Rig | None) -> Recording:
    cameras = sorted(p.name for p in (folder / layout.images).glob("camera_*") if p.is_dir())
    if not cameras:
        raise FileError(folder / layout.images, "no folder of a camera", valid="camera_left, ...")
    cameras.sort(key=lambda name: ("back" in name, name))
    images = {name: numbered(folder / layout.images / name) for name in cameras}
    files = numbered(folder / layout.json, (".json",))
    frames = tuple(files or images[cameras[0]])
    if not frames:
        raise FileError(folder, "neither JSON files nor images of frames")
    pictures = tuple(_pictures(folder / layout.images, images, n) for n in frames)
    points = _Points.read(files, layout, cameras) if files else None
    T_head_device = looking_down(layout.forward, layout.up)
    if rig is None:
        lenses = [_calibration(layout, folder, camera) for camera in cameras]
        rig = (_nominal_rig(dataset, layout, folder, cameras, lenses) if points is None
               else _rig(dataset, T_head_device, folder, cameras, lenses, points))  # fmt: skip
    elif points is not None:
        what = f"device_pts3d and {cameras[0]}_pts3d"
        device = _device_points(points, folder)
        T_head_device = rig.T_head_camera[0] @ rigid_fit(device, points.camera[:, 0], folder, what)
    labels = None if points is None else _labels(layout, rig, points, T_head_device, folder)
    name = folder.relative_to(root).as_posix() if folder != root else folder.name
    category = folder.parent.name if dataset in ("unrealego", "unrealego2") else ""
    times = frame_times(frames, RATE)
    return Recording(
        dataset, name, rig, times, frames, pictures, labels, T_head_device, category=category
    )  # fmt: skip


def _pictures(folder: Path, images: dict[str, dict[int, Path]], n: int) -> tuple[Picture, ...]:
    for camera, found in images.items():
        if n not in found:
            raise FileError(folder / camera, f"no image of frame {n}")
    return tuple(Picture(found[n]) for found in images.values())


@dataclass(frozen=True, eq=False)
class _Points:
    """Joints of all frames as they are in the files, metres and pixels; axis J of the data set."""

    device: Float[Array, "T J 3"] | None
    camera: Float[Array, "T V J 3"]
    pixels: Float[Array, "T V J 2"]
    world: Float[Array, "T J 3"]

    @classmethod
    def read(cls, files: dict[int, Path], layout: Layout, cameras: list[str]) -> _Points:
        rows = [_frame(path, layout, cameras) for path in files.values()]
        device, camera, pixels, world = (list(column) for column in zip(*rows, strict=True))
        given = [d is not None for d in device]
        if any(given) and not all(given):
            path = list(files.values())[given.index(False)]
            raise FileError(path, "missing, though other frames have it", key="device_pts3d")
        return cls(np.stack(device) if all(given) else None, np.stack(camera),
                   np.stack(pixels), np.stack(world))  # fmt: skip


def _frame(path: Path, layout: Layout, cameras: list[str]) -> tuple[Any, Array, Array, Array]:
    joints = item(read_json(path), path, "joints")
    names = JOINT_ORDER[layout.joints]

    def stack(key: str, size: int) -> Array:
        return np.stack([array(joints, path, name, key, shape=(size,)) for name in names])

    first = item(joints, path, names[0])
    given = isinstance(first, dict) and "device_pts3d" in first
    device = CM * stack("device_pts3d", 3) if given else None
    camera = CM * np.stack([stack(f"{name}_pts3d", 3) for name in cameras])
    pixels = np.stack([stack(f"{name}_pts2d", 2) for name in cameras])
    return device, camera, pixels, stack(layout.trans, 3) * layout.to_world


def _calibration(layout: Layout, folder: Path, camera: str) -> Camera:
    names = [name.format(camera=camera) for name in layout.calibrations]
    return find_camera(folder, names, "the repository of the data set's code")


def _rig(
    dataset: str, T_head_device: Float[Array, "4 4"], folder: Path, cameras: list[str],
    lenses: list[Camera], points: _Points,
) -> Rig:  # fmt: skip
    """The rig that the labels imply: each camera's pose fitted to the joints of all frames."""
    device = _device_points(points, folder)
    mounts = []
    for v, (camera, lens) in enumerate(zip(cameras, lenses, strict=True)):
        what = f"device_pts3d and {camera}_pts3d"
        T_device_camera = rigid_fit(points.camera[:, v], device, folder, what)
        mounts.append(Mount(camera.removeprefix("camera_"), lens, T_head_device @ T_device_camera))
    return Rig(dataset, tuple(mounts), RATE)


def _device_points(points: _Points, folder: Path) -> Float[Array, "T J 3"]:
    """Joints in the device's frame: as given, else the mean of two parallel cameras'."""
    if points.device is not None:
        return points.device
    apart = np.ptp(points.camera - points.camera.mean(1, keepdims=True), axis=(0, 2)).max()
    if points.camera.shape[1] != 2 or apart > TOLERANCE_M:
        raise FileError(folder, "the cameras are not parallel, so their mean is no device frame",
                        valid="device_pts3d for every joint")  # fmt: skip
    return points.camera.mean(1)


def _nominal_rig(
    dataset: str, layout: Layout, folder: Path, cameras: list[str], lenses: list[Camera]
) -> Rig:
    """The rig of frames without labels, where the cameras are known to be parallel."""
    if layout.baseline is None or len(cameras) != 2:
        raise FileError(folder, f"no {layout.json}: without labels the rig is unknown",
                        valid=f"{layout.json}/*.json, or --rig")  # fmt: skip
    T_head_device = looking_down(layout.forward, layout.up)
    mounts = []
    for side, camera, lens in zip((-1, 1), cameras, lenses, strict=True):
        T_device_camera = rigid(np.eye(3), np.array([side * layout.baseline / 2, 0.0, 0.0]))
        mounts.append(Mount(camera.removeprefix("camera_"), lens, T_head_device @ T_device_camera))
    return Rig(dataset, tuple(mounts), RATE)


def _labels(
    layout: Layout, rig: Rig, points: _Points, T_head_device: Float[Array, "4 4"], folder: Path
) -> Labels:
    joints = transform(T_head_device, _device_points(points, folder))
    head, labelled = on_labels(joints, JOINT_ORDER[layout.joints], layout.joints)
    pixels, there = on_labels(points.pixels, JOINT_ORDER[layout.joints], layout.joints)
    T_world_head = head_poses(joints, points.world)
    return Labels(head, labelled, pixels, there & inside_images(pixels, rig), T_world_head)
