"""Detections as COCO keypoint results: one entry an image with a detection.

Images are numbered from 1, all views of a frame after each other, as `egocap-sim export --format
coco` numbers those of a sequence without dropped frames. The third value of a keypoint is its
visibility probability, 0 with x = y = 0 where there is no detection. Pixel (0, 0) is the centre of
the top-left pixel.

Source: https://cocodataset.org/#format-results
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from egocap.data.detections import Detections
from egocap.files import write_atomically

_PERSON = 1


def write_coco(path: Path, detections: Detections) -> None:
    """Write detections as JSON, atomically. Raises as `egocap.files.disk_errors`."""
    score = np.where(detections.valid, detections.confidence, 0.0)
    found = np.where(detections.valid[..., None], detections.points, 0.0)
    keypoints = np.concatenate([found, score[..., None]], -1).round(4)
    views = detections.valid.shape[1]
    results = [
        {"image_id": int(t * views + v + 1), "category_id": _PERSON,
         "keypoints": keypoints[t, v].ravel().tolist(),
         "score": round(float(score[t, v][detections.valid[t, v]].mean()), 4)}
        for t, v in np.argwhere(detections.valid.any(-1))
    ]  # fmt: skip
    write_atomically(path, json.dumps(results))
