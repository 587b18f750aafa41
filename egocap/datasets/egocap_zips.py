"""EgoCap's published sets: training_v000, training_v002, validation_v003_2D, validation_v003_3D.

Each is a zip archive or the folder it unzips to. `dataset.txt` of the 2-D sets lists an image and
18 joints, x and y at 640 x 512 measured from the image's corner; images and labels of cam1 are
mirrored, and are turned back here. `dataset3D.mddd` has 18 joints in millimetres in cam0's OpenCV
frame; frame N of cam0 and frame N - 85 of cam1 were taken at the same time. Images of cam1 are not
mirrored there. The 2-D sets pair no images across the cameras: each camera is a recording of its
own, without 3-D labels.

Source: the data set's readme as public loaders follow it; calibrations are OCamCalib text files and
a Skeletool file of camera poses.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import MIRROR
from egocap.cameras.camera_files import parse_ocam_text
from egocap.cameras.rig import Mount, Rig
from egocap.datasets.mounting import looking_down, upright
from egocap.datasets.pictures import Picture, Tree
from egocap.datasets.recording import Labels, Recording, frame_times, inside_images
from egocap.errors import FileError
from egocap.geometry import inverse, rigid, transform

MM = 0.001
RATE = 30.0  # Hz
LAG = 85  # frames by which cam1's numbers are behind cam0's in validation_v003_3D
SIZE = (640, 512)  # pixels of the 2-D labels
SETS_2D = ("training_v000", "training_v002", "validation_v003_2D")
SET_3D = "validation_v003_3D"
POSES = ("dataset3D.mddd", "dataset3D.txt")
CALIBRATIONS = tuple(f"cameraCalibration/stereo_c0{v}_f_calibration.txt" for v in (0, 1))
EXTRINSICS = "cameraCalibration/calibrationFileV5.calibration"
T_HEAD_CAMERA = looking_down(0.37, 0.14)  # of a 2-D recording; with poses, their mean posture
_IMAGE = re.compile(r"S(\d+)_v(\d+)_cam([01])_frame-?(\d+)\.(?:jpg|png)$")
_FLIP_Z = np.diag([1.0, 1.0, -1.0, 1.0])  # Skeletool looks along -z


def recordings(dataset: str, root: Path, rig: Rig | None = None) -> Iterator[Recording]:
    """The recordings of all sets in a folder, or of the one set that the folder or archive is.

    Raises FileError for a part missing or unknown.
    """
    parent, names = _sets(root)
    mounted, rig = rig is not None, rig or _rig(dataset, parent)
    for name in names:
        if name == SET_3D:
            yield _poses(dataset, parent, rig, mounted)
        else:
            yield from _images(dataset, parent, name, rig, mounted)


def _sets(root: Path) -> tuple[Path, list[str]]:
    """The folder of the sets, and which of them to read."""
    known, stem = (*SETS_2D, SET_3D), root.name.removesuffix(".zip")
    if stem in known:
        return root.parent, [stem]
    names = [n for n in known if (root / n).is_dir() or (root / f"{n}.zip").is_file()]
    if not names:
        raise FileError(root, "none of EgoCap's sets", valid=[f"{n}[.zip]" for n in known])
    return root, names


def _rig(dataset: str, parent: Path) -> Rig:
    """Cameras at the calibrated size; cam0's frame is the device's."""
    tree = Tree(parent / SET_3D)
    cameras = [parse_ocam_text(tree.text(name), tree.where(name)) for name in CALIBRATIONS]
    T_cam1_cam0 = _extrinsic(tree.text(EXTRINSICS), tree.where(EXTRINSICS))
    poses = (np.eye(4), inverse(T_cam1_cam0))
    mounts = [Mount(f"cam{v}", c, T) for v, (c, T) in enumerate(zip(cameras, poses, strict=True))]
    return Rig(dataset, tuple(mounts), RATE)


def _extrinsic(text: str, path: Path) -> Float[Array, "4 4"]:
    """T_cam1_cam0 in metres from a Skeletool file: `extrinsic` maps the world to the camera."""
    lines = [line.split() for line in text.splitlines()]
    found = [words[1:] for words in lines if words[:1] == ["extrinsic"]]
    try:
        first, second = (np.array(words, float).reshape(4, 4) for words in found[:2])
    except ValueError:
        raise FileError(path, "no extrinsic of two cameras", key="extrinsic",
                        valid="two lines of 16 numbers") from None  # fmt: skip
    T = _FLIP_Z @ second @ np.linalg.inv(first) @ _FLIP_Z
    u, _, v = np.linalg.svd(T[:3, :3])  # the digits are rounded
    if np.abs(u @ v - T[:3, :3]).max() > 1e-3 or np.linalg.det(u @ v) < 0:
        raise FileError(path, "not a rigid transform", key="extrinsic")
    return rigid(u @ v, MM * T[:3, 3])


@dataclass(frozen=True, eq=False)
class _Example:
    """An entry of dataset.txt, unmirrored."""

    name: str
    subject: int
    camera: int
    frame: int
    points: Float[Array, "18 2"]  # from the corner of the image, at SIZE


def _examples(tree: Tree) -> list[_Example]:
    path, found = tree.where("dataset.txt"), []
    entries = re.split(r"^#.*$", tree.text("dataset.txt"), flags=re.MULTILINE)[1:]
    for number, entry in enumerate(entries):
        lines = entry.split("\n")
        words = [line.split() for line in lines if line.strip()]
        image = _IMAGE.search(words[0][0]) if words else None
        if image is None:
            raise FileError(path, "no image of the form S1_v000_cam0_frame-0001.jpg",
                            key=f"example {number}")  # fmt: skip
        rows = [row for row in words if len(row) == 3]
        try:
            points = np.array(rows, float).reshape(18, 3)[:, 1:]
        except ValueError:
            raise FileError(path, f"{len(rows)} joints", key=f"example {number}",
                            valid="18 lines of index, x and y") from None  # fmt: skip
        subject, _, camera, frame = (int(text) for text in image.groups())
        if camera == 1:
            points = (points * [-1.0, 1.0] + [SIZE[0], 0.0])[list(MIRROR)]
        name = words[0][0].removeprefix("./")
        found.append(_Example(name, subject, camera, frame, points))
    if not found:
        raise FileError(path, "holds no example")
    return found


def _images(dataset: str, parent: Path, name: str, rig: Rig, mounted: bool) -> Iterator[Recording]:
    """The recordings of a 2-D set. `mounted`: the rig's poses are on the head."""
    tree = Tree(parent / name)
    groups: dict[tuple[int, int], list[_Example]] = {}
    for example in _examples(tree):
        groups.setdefault((example.subject, example.camera), []).append(example)
    for (subject, v), examples in sorted(groups.items()):
        examples.sort(key=lambda example: example.frame)
        frames = tuple(example.frame for example in examples)
        if len(set(frames)) < len(frames):
            problem = f"S{subject} cam{v} has a frame twice"
            raise FileError(tree.where("dataset.txt"), problem)
        pictures = tuple((tree.picture(e.name, mirrored=v == 1),) for e in examples)
        pose = rig.T_head_camera[v] if mounted else T_HEAD_CAMERA
        one = replace(rig, mounts=(replace(rig.mounts[v], T_head_camera=pose),))
        one = _at_image_size(one, pictures[0])
        points = _pixels(np.stack([e.points for e in examples])[:, None], one)
        nowhere = np.zeros((len(frames), 18, 3))
        there = inside_images(points, one)
        labels = Labels(nowhere, np.zeros((len(frames), 18), bool), points, there)
        yield Recording(dataset, f"{name}/S{subject}/cam{v}", one, frame_times(frames, RATE),
                        frames, pictures, labels)  # fmt: skip


def _poses(dataset: str, parent: Path, rig: Rig, mounted: bool) -> Recording:
    tree = Tree(parent / SET_3D)
    name = next((n for n in POSES if n in set(tree.names(""))), POSES[0])
    rows = _rows(tree.text(name), tree.where(name))
    frames = tuple(int(frame) for frame in rows[:, 0])
    device = MM * rows[:, 1:].reshape(-1, 18, 3)
    T_head_device = rig.T_head_camera[0]
    if not mounted:
        upright_pose = upright(device, np.ones(device.shape[:2], bool))
        assert upright_pose is not None
        T_head_device = upright_pose
        rig = replace(rig, mounts=tuple(
            replace(m, T_head_camera=T_head_device @ m.T_head_camera) for m in rig.mounts
        ))  # fmt: skip
    pictures = tuple((
        tree.picture(f"images/franzi_01-cam0/frame-{n}.jpg"),
        tree.picture(f"images/franzi_01-cam1/frame-{n - LAG}.jpg"),
    ) for n in frames)  # fmt: skip
    rig = _at_image_size(rig, pictures[0])
    points, there = _points_of(parent, frames, rig)
    labels = Labels(
        transform(T_head_device, device), np.ones(device.shape[:2], bool), points, there
    )
    return Recording(
        dataset, SET_3D, rig, frame_times(frames, RATE), frames, pictures, labels
    )  # fmt: skip


def _rows(text: str, path: Path) -> Float[Array, "T 55"]:
    """Rows of frame number and 18 points; header and Skeletool lines are skipped."""
    rows = []
    for number, line in enumerate(text.splitlines()[1:], 2):
        words = line.split()
        if len(words) < 2 or words[0].startswith("Skeletool"):
            continue
        try:
            rows.append(np.array(words, float).reshape(55))
        except ValueError:
            problem = f"{len(words)} values"
            raise FileError(path, problem, line=number, valid="frame and 18 points") from None
    if not rows:
        raise FileError(path, "holds no pose")
    table = np.stack(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    if (np.diff(table[:, 0]) <= 0).any() or not np.isfinite(table).all():
        raise FileError(path, "a frame is repeated, or a value is not finite")
    return table


def _points_of(
    parent: Path, frames: tuple[int, ...], rig: Rig
) -> tuple[Float[Array, "T 2 18 2"], Array]:
    """2-D labels of the 3-D set's frames, from validation_v003_2D where it is there."""
    points = np.full((len(frames), 2, 18, 2), np.nan)
    try:
        tree = Tree(parent / SETS_2D[2])
    except FileError:
        examples = []
    else:
        examples = [e for e in _examples(tree) if e.subject == 7]
    row = {n: i for i, n in enumerate(frames)}
    for example in examples:
        number = example.frame + LAG * example.camera
        if number in row:
            points[row[number], example.camera] = example.points
    there = np.asarray(np.isfinite(points).all(-1))
    pixels = _pixels(np.where(there[..., None], points, 0.0), rig)
    return pixels, np.asarray(there & inside_images(pixels, rig))


def _pixels(points: Float[Array, "T V 18 2"], rig: Rig) -> Float[Array, "T V 18 2"]:
    """From the corner of an image of SIZE to the pixel centres of the rig's images."""
    scale = [(camera.width / SIZE[0], camera.height / SIZE[1]) for camera in rig.cameras]
    return points * np.array(scale)[:, None] - 0.5


def _at_image_size(rig: Rig, pictures: tuple[Picture, ...]) -> Rig:
    """The rig at the size of the images, which are smaller than the calibrated ones."""
    height, width = pictures[0].read().shape[:2]
    return rig.resized(width, height)
