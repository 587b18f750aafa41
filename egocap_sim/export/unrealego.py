"""Export to UnrealEgo's folders: a JSON file a frame in centimetres, PNG images, depth if recorded.

World positions and rotations are Unreal's: left-handed, z up, rotations as pitch, yaw and roll in
degrees. Points in a camera's frame are OpenCV's.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.ocam_files import ocam_calibration
from egocap.data.sequence import Sequence
from egocap.errors import FileError, InputError
from egocap.files import disk_errors, write_atomically
from egocap.geometry import inverse, transform
from egocap_sim.core.bodies import INDEX, LABEL_BODY
from egocap_sim.export.formats import new_folder

_SIDES = {"l": "left", "r": "right"}
_PARTS = {"upperarm": "shoulder", "lowerarm": "elbow", "hand": "wrist", "thigh": "hip",
          "calf": "knee", "foot": "ankle", "ball": "foot"}  # fmt: skip
JOINTS: dict[str, str] = {"head": "head", "neck_01": "neck"} | {
    f"{theirs}_{s}": f"{side}_{ours}" for theirs, ours in _PARTS.items()
    for s, side in _SIDES.items()
}  # fmt: skip
"""UnrealEgo's 16 joints, in its order, and their labels in EgoCap."""

R_CAMERA_UNREAL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Columns: Unreal's forward, left (unmirrored) and up in a camera's OpenCV frame."""
_MIRROR = np.array([1.0, -1.0, 1.0])  # between right- and left-handed axes

_README = """\
{name}: a simulated sequence in UnrealEgo's layout, written by egocap-sim {version}.

Lengths are centimetres, images and 2-D points pixels, (0, 0) the centre of the top-left pixel.
trans, rot: Unreal's world, left-handed, z up; pitch, yaw and roll in degrees. A camera looks along
its x axis, z up. Bones have the simulation's axes.
camera_*_pts3d: the camera's frame, x right, y down, z forward. The device-relative pose is the mean
of camera_left_pts3d and camera_right_pts3d. Depth images, where there are any: 16-bit PNG,
millimetres along the ray, 0 where nothing was hit. The preprocessed npy files are not written.
camera_left.json, camera_right.json: the calibrations, in UnrealEgo's own form.
"""


def write_unrealego(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write out/ENVIRONMENT/Day/PERSON/RIG/MOTION/NAME/{fisheye_final_image,json,...}."""
    views = sequence.manifest.views
    if set(views) != {"left", "right"}:
        raise InputError(f"UnrealEgo has two cameras, left and right; this has {', '.join(views)}")
    new_folder(out)
    place = _place(sequence)
    folder = out / place
    (folder / "json").mkdir(parents=True)
    depth = sequence.depth(0, views[0]) is not None
    for view in views:
        for kind in ("fisheye_final_image", *(["fisheye_depth_image"] if depth else [])):
            (folder / kind / f"camera_{view}").mkdir(parents=True)
    dropped = None if sequence.sensor is None else sequence.sensor.dropped
    for frame in range(len(sequence)):
        if dropped is not None and dropped[frame].any():  # pictures that are not of their labels
            on_frames(1)
            continue
        content = json.dumps(frame_content(sequence, frame)).encode()
        with disk_errors(folder):
            (folder / "json" / f"frame_{frame}.json").write_bytes(content)
            _write_images(sequence, frame, folder, depth)
        on_frames(1)
    manifest = sequence.manifest
    text = _README.format(name=manifest.name, version=manifest.code_version)
    (out / "README.txt").write_text(text)
    (out / "train.txt").write_text(f"{place.as_posix()}\n")
    for mount in sequence.true_rig.mounts:
        name = f"camera_{mount.name}"
        calibration = json.dumps(ocam_calibration(mount.camera, name), indent=1)
        write_atomically(out / f"{name}.json", calibration.encode())


def frame_content(sequence: Sequence, frame: int) -> dict[str, Any]:
    """The JSON of one frame."""
    truth, rig = sequence.truth, sequence.true_rig
    pelvis = truth.T_world_body[frame, INDEX["pelvis"]]
    T_camera_world = inverse(truth.T_world_head[frame] @ rig.T_head_camera)
    content: dict[str, Any] = {"ground_z_value": 0.0, "joints": {}}
    for name, label in JOINTS.items():
        j = LABEL_INDEX[label]
        joint = _pose(truth.joints_world[frame, j],
                      truth.T_world_body[frame, INDEX[LABEL_BODY[label]], :3, :3])  # fmt: skip
        for v, view in enumerate(rig.views):
            joint[f"camera_{view}_pts3d"] = _centimetres(truth.joints_camera[frame, v, j])
            joint[f"camera_{view}_pts2d"] = truth.joints_2d[frame, v, j].tolist()
        content["joints"][name] = joint
    joint = _pose(pelvis[:3, 3], pelvis[:3, :3])
    for v, mount in enumerate(rig.mounts):
        point = transform(T_camera_world[v], pelvis[None, :3, 3])[0]
        joint[f"camera_{mount.name}_pts3d"] = _centimetres(point)
        joint[f"camera_{mount.name}_pts2d"] = mount.camera.project(point)[0].tolist()
        T_world_camera = inverse(T_camera_world[v])
        looking = T_world_camera[:3, :3] @ R_CAMERA_UNREAL
        content[f"camera_{mount.name}"] = _pose(T_world_camera[:3, 3], looking)
    content["joints"]["pelvis"] = joint
    return content


def _write_images(sequence: Sequence, frame: int, folder: Path, depth: bool) -> None:
    images = sequence.frame(frame).images
    for view, image in zip(sequence.manifest.views, images, strict=True):
        path = folder / "fisheye_final_image" / f"camera_{view}" / f"final_{frame}.png"
        path.write_bytes(_png(image[..., ::-1]))
        if depth:
            path = folder / "fisheye_depth_image" / f"camera_{view}" / f"depth_{frame}.png"
            if (plane := sequence.depth(frame, view)) is None:
                raise FileError(
                    sequence.shard_path(frame), f"no depth in frame {frame} of '{view}'",
                    valid="depth in all frames, or in none",
                )  # fmt: skip
            path.write_bytes(_png(plane))


def _place(sequence: Sequence) -> Path:
    """Environment/Day/Human/Glasses/MotionCategory/Sequence of a sequence."""
    config, name = sequence.manifest.config, sequence.manifest.name
    motion = config.get("motion")
    clip = motion.get("file") if isinstance(motion, dict) else None
    steps = (
        _named(config.get("place")) or "place",
        "Day",
        f"person_{sequence.manifest.seed}",
        sequence.rig.name,
        _named(clip) or _named(motion) or "motion",
        f"{name}_{sequence.manifest.seed}",
    )
    return Path(*(re.sub(r"[^\w.-]|^\.+", "_", str(step)) or "_" for step in steps))


def _named(table: Any) -> Any:
    """Name that a table of the configuration states, if any."""
    return table.get("name") if isinstance(table, dict) else None


def _pose(position: Any, rotation: Any) -> dict[str, Any]:
    """Position and rotation of a frame (axes forward, left, up as columns) in Unreal's world."""
    return {"trans": (_MIRROR * _centimetres(position)).tolist(), "rot": _rotator(rotation)}


def _rotator(rotation: Float[Array, "3 3"]) -> list[float]:
    """Pitch, yaw and roll in degrees, as Unreal's FMatrix::Rotator."""
    x, y, z = (_MIRROR[:, None] * rotation * _MIRROR).T
    pitch, yaw = np.arctan2(x[2], np.hypot(x[0], x[1])), np.arctan2(x[1], x[0])
    level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])  # the y axis without roll
    return np.degrees([pitch, yaw, np.arctan2(z @ level, y @ level)]).tolist()


def _centimetres(point: Any) -> list[float]:
    return (100.0 * np.asarray(point)).tolist()


def _png(image: Any) -> bytes:
    done, data = cv2.imencode(".png", image)
    assert done
    return data.tobytes()
