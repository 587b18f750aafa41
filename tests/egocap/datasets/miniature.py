"""A few frames in the frames of reference of data sets, and joint names written out by hand.

Writers of miniature data sets stand in the tests of their readers. They use the data set's own
conventions and none of the reader's code.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from egocap.body.labels import LABEL_INDEX
from egocap.cameras.camera import Camera

UNREALEGO = {"head": "head", "neck_01": "neck"} | {
    f"{theirs}_{s}": f"{side}_{ours}"
    for theirs, ours in [("upperarm", "shoulder"), ("lowerarm", "elbow"), ("hand", "wrist"),
                         ("thigh", "hip"), ("calf", "knee"), ("foot", "ankle"), ("ball", "foot")]
    for s, side in [("l", "left"), ("r", "right")]
}  # fmt: skip
MIXAMO = {"Head": "head", "Neck": "neck"} | {
    f"{side}{theirs}": f"{side.lower()}_{ours}"
    for theirs, ours in [("Arm", "shoulder"), ("ForeArm", "elbow"), ("Hand", "wrist"),
                         ("UpLeg", "hip"), ("Leg", "knee"), ("Foot", "ankle"), ("ToeBase", "foot")]
    for side in ("Left", "Right")
}  # fmt: skip
MO2CAP2 = (
    "neck", "right_shoulder", "right_elbow", "right_wrist",
    "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "right_foot",
    "left_hip", "left_knee", "left_ankle", "left_foot",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shot:
    """Joints (18) of a few frames in the frames of reference that data sets use."""

    camera: np.ndarray  # (T, V, 18, 3) metres, OpenCV
    device: np.ndarray  # (T, 18, 3) metres: x right, y back, z down
    world: np.ndarray  # (T, 18, 3) metres, right-handed, z up
    pixels: np.ndarray  # (T, V, 18, 2)
    T_device_camera: np.ndarray  # (V, 4, 4)
    cameras: tuple[Camera, ...]

    def __len__(self):
        return len(self.world)

    def image(self, t: int, v: int) -> np.ndarray:
        """RGB image of a frame, each different."""
        camera = self.cameras[v]
        image = np.full((camera.height, camera.width, 3), (10 * t, 40 * v + 20, 90), np.uint8)
        image[:, : camera.width // 3] += 60  # left and right differ
        return image

    def write(self, path: Path, t: int, v: int, mirrored: bool = False) -> None:
        """Write an image losslessly: PNG content, whatever the suffix."""
        path.parent.mkdir(parents=True, exist_ok=True)
        image = self.image(t, v)[:, ::-1] if mirrored else self.image(t, v)
        path.write_bytes(cv2.imencode(".png", image[..., ::-1])[1].tobytes())

    def joint(self, label: str, points: np.ndarray) -> list[float]:
        """One joint of (18, C) points."""
        return points[LABEL_INDEX[label]].tolist()
