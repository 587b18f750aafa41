"""Export to COCO keypoints: annotations.json and the images, one annotation an image.

Keypoints are the 18 labels in their order, as x, y, v with v = 0 outside the view (x = y = 0), 1
occluded, 2 visible. Pixel (0, 0) is the centre of the top-left pixel. Dropped frames are left out,
since their images do not belong to their labels; the numbers of the other images stay, as `egocap
export` numbers detections.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.data.sequence import Sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.files import disk_errors, write_atomically
from egocap_sim.core.part_labels import WEARER_FIRST, WEARER_LAST
from egocap_sim.export.formats import new_folder

_CATEGORY = {
    "id": 1,
    "name": "person",
    "supercategory": "person",
    "keypoints": list(LABELS),
    "skeleton": [[a + 1, b + 1] for a, b in LIMBS],
}

_NO_BOX = [0.0, 0.0, 0.0, 0.0]


def write_coco(sequence: Sequence, out: Path, on_frames: Callable[[int], None]) -> None:
    """Write out/annotations.json and out/images/VIEW/NUMBER.jpg (or .png)."""
    new_folder(out)
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    dropped = None if sequence.sensor is None else sequence.sensor.dropped
    for view in sequence.manifest.views:
        (out / "images" / view).mkdir(parents=True)
    for frame in range(len(sequence)):
        for v, mount in enumerate(sequence.true_rig.mounts):
            suffix = sequence.image_suffix(frame, v)
            if suffix is None or (dropped is not None and dropped[frame, v]):
                continue
            name = f"images/{mount.name}/{frame:06d}.{suffix.rpartition('.')[2]}"
            with disk_errors(out / name):
                (out / name).write_bytes(sequence.read(frame, suffix))
            images.append({
                "id": frame * len(sequence.manifest.views) + v + 1, "file_name": name,
                "frame": frame, "view": mount.name,
                "width": mount.camera.width, "height": mount.camera.height,
            })  # fmt: skip
            annotations.append(_annotation(sequence, frame, v, images[-1]["id"]))
        on_frames(1)
    content = {
        "info": {"description": sequence.manifest.name, "version": sequence.manifest.code_version,
                 "contributor": "egocap-sim, simulated"},
        "licenses": [],
        "categories": [_CATEGORY],
        "images": images,
        "annotations": annotations,
    }  # fmt: skip
    write_atomically(out / "annotations.json", json.dumps(content).encode())


def _annotation(sequence: Sequence, frame: int, v: int, image: int) -> dict[str, Any]:
    truth, camera = sequence.truth, sequence.true_rig.cameras[v]
    visibility = truth.visibility[frame, v]
    labelled = visibility != OUT_OF_VIEW
    points = np.where(labelled[:, None], truth.joints_2d[frame, v], 0.0)
    flags = np.where(visibility == VISIBLE, 2, np.where(labelled, 1, 0))
    mask = sequence.mask(frame, sequence.manifest.views[v])
    if mask is None:
        box, area = _box_of_points(points[labelled], camera.width, camera.height)
    else:
        box, area = _box_of_mask(mask)
    return {
        "id": image,
        "image_id": image,
        "category_id": 1,
        "iscrowd": 0,
        "keypoints": [
            value
            for (x, y), flag in zip(points.round(3).tolist(), flags.tolist(), strict=True)
            for value in (x, y, flag)
        ],
        "num_keypoints": int(labelled.sum()),
        "bbox": box,
        "area": area,
    }


def _box_of_mask(mask: UInt8[Array, "H W"]) -> tuple[list[float], float]:
    """Box (x, y, width, height) and area of the wearer's pixels."""
    wearer = (mask >= WEARER_FIRST) & (mask <= WEARER_LAST)
    if not wearer.any():
        return _NO_BOX, 0.0
    columns, rows = np.flatnonzero(wearer.any(0)), np.flatnonzero(wearer.any(1))
    x, y = float(columns[0]), float(rows[0])
    return [x, y, columns[-1] - x + 1.0, rows[-1] - y + 1.0], float(wearer.sum())


def _box_of_points(
    points: Float[Array, "n 2"], width: int, height: int
) -> tuple[list[float], float]:
    """Box of the joints in view and its area, for sequences without part labels."""
    if not len(points):
        return _NO_BOX, 0.0
    low = np.clip(points.min(0), 0, None)
    size = np.minimum(points.max(0), (width, height)) - low
    return [*low.tolist(), *size.tolist()], float(size.prod())
