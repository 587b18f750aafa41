"""A tracker of your own: triangulates every joint that both cameras detect, and knows nothing else.

Run and score it on any sequence, beside the built-in one:

    egocap-sim generate validation-walk --out out/walk
    PYTHONPATH=examples egocap-eval pose out/walk --tracker your_tracker:track \
        --detections simulated:2.0
    egocap-eval pose out/walk --tracker egocap --detections simulated:2.0

Or, for a method that runs elsewhere, write a neutral file and hand that in:

    python examples/your_tracker.py out/walk out/walk.jsonl
    egocap-eval pose out/walk --predictions out/walk.jsonl

A package that declares `[project.entry-points."egocap.trackers"] mine = "my_package:track"` is
found as `--tracker mine`.
"""

import sys
from pathlib import Path

import numpy as np

from egocap.data.detections import Detections
from egocap.data.plugins import SequenceView
from egocap.data.sequence import open_sequence
from egocap.detect.sources import detections_from
from egocap.evaluation.predictions import Predictions, save_predictions


def track(footage: SequenceView, detections: Detections | None) -> np.ndarray:
    """(T, 18, 3) joints in the head frame, metres; NaN where fewer than two cameras see one."""
    assert detections is not None, "this tracker needs detections in both views"
    starts, rays = [], []  # a view each: where its rays start (3,), their directions (T, 18, 3)
    for view, mount in enumerate(footage.rig.mounts):
        pixels = np.where(detections.valid[:, view, :, None], detections.points[:, view], 0.0)
        camera_rays, _ = mount.camera.ray(pixels)
        T_head_camera = mount.T_head_camera
        rays.append(camera_rays @ T_head_camera[:3, :3].T)
        starts.append(T_head_camera[:3, 3])
    # The point nearest to all rays: sum of (I - r r^T)(x - start) = 0, a 3 x 3 system a joint.
    across = [np.eye(3) - r[..., :, None] * r[..., None, :] for r in rays]
    normal = sum(across)
    right = sum(a @ s for a, s in zip(across, starts, strict=True))
    both = detections.valid.all(1)  # (T, 18)
    joints = np.full((*both.shape, 3), np.nan)
    joints[both] = np.linalg.solve(normal[both], right[both][..., None])[..., 0]
    return joints


def main(sequence: str, out: str) -> None:
    """Track a sequence from simulated detections and write a neutral file."""
    opened = open_sequence(sequence)
    joints = track(SequenceView(opened), detections_from(opened, "simulated:2.0", seed=0))
    valid = np.isfinite(joints).all(-1)
    save_predictions(
        Path(out),
        Predictions(joints, valid, frame="head", unit="m", frames=np.arange(len(joints)),
                    method="triangulation"),
    )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
