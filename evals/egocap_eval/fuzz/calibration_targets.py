"""More formats under test: calibrations of other programs, as `egocap rig convert` reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from egocap.data.sequence import Sequence

_FILES = {
    "kalibr": "kalibr.yaml", "opencv": "opencv.yml", "opencv-xml": "opencv.xml",
    "colmap": "cameras.txt", "aria": "aria.json", "ros": "ros.yaml", "ocam": "ocam-out.txt",
    "unrealego": "unrealego.json",
}  # fmt: skip


def calibrations(sequence: Sequence, work: Path) -> list[tuple[str, Path, Any]]:
    """A file of every format: name, file and reader."""
    from egocap.cameras.camera_set import CameraSet
    from egocap.cameras.formats import WRITERS, format_cameras
    from egocap.cameras.rig_files import load_rig_or_cameras

    assert _FILES.keys() == WRITERS.keys()
    pair = CameraSet.of(sequence.rig)
    targets = []
    for format, name in _FILES.items():
        cameras = pair if WRITERS[format][1] else CameraSet(pair.cameras[:1])
        files, _ = format_cameras(cameras, format, work / name)
        for path, text in files.items():
            path.write_text(text)
            targets.append((name, path, load_rig_or_cameras))
    lines = work / "aria.jsonl"
    lines.write_text("".join((work / "aria.json").read_text().split("\n")) + "\n")
    return [*targets, (lines.name, lines, load_rig_or_cameras)]
