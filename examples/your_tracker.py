"""A tracker of your own: it triangulates every joint that both cameras detect.

Run and score it on any sequence, beside the built-in tracker:

    egocap-sim generate validation-walk --out out/walk
    PYTHONPATH=examples egocap-eval pose out/walk --tracker your_tracker:track \
        --detections simulated:2.0
    egocap-eval pose out/walk --tracker egocap --detections simulated:2.0

If your method runs elsewhere, write a neutral file and score that:

    python examples/your_tracker.py out/walk out/walk.jsonl
    egocap-eval pose out/walk --predictions out/walk.jsonl

An installed package with `[project.entry-points."egocap.trackers"] mine = "my_package:track"` is
available as `--tracker mine`.
"""

import sys
from pathlib import Path

import numpy as np

import egocap
from egocap.evaluation import Predictions, save_predictions


def track(footage, detections: egocap.Detections) -> np.ndarray:
    """(T, 18, 3) joints in the head frame, metres; NaN where rays are missing or parallel.

    `footage` has the images, times, rig and body of a sequence, without its truth.
    """
    pixels = np.where(detections.valid[..., None], detections.points, 0.0)
    origins, rays, _ = footage.rig.rays(np.swapaxes(pixels, 0, 1))  # (V, 3), (V, T, 18, 3)
    # The point nearest to all rays: sum of (I - r r^T)(x - origin) = 0, a 3 x 3 system a joint.
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    normal = across.sum(0)
    right = np.einsum("vtjab,vb->tja", across, origins)
    solvable = detections.valid.all(1) & (np.linalg.det(normal) > 1e-9)  # (T, 18)
    joints = np.full((*solvable.shape, 3), np.nan)
    joints[solvable] = np.linalg.solve(normal[solvable], right[solvable][..., None])[..., 0]
    return joints


def main(folder: str, out: str) -> None:
    """Track a sequence from simulated detections, print its score and write a neutral file."""
    sequence = egocap.open_sequence(folder)
    joints = track(sequence, egocap.synthetic_detections(sequence))
    print(egocap.evaluate(joints, sequence))
    found = np.isfinite(joints).all(-1)
    frames = np.arange(len(joints))
    predictions = Predictions(
        joints, found, frame="head", unit="m", frames=frames, method="triangulation"
    )
    save_predictions(Path(out), predictions)


if __name__ == "__main__":
    main(*sys.argv[1:])
