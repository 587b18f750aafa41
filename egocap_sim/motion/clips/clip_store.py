"""Disk cache of loaded motion files, since cleaning a file takes seconds.

The key is a hash of the file's content, the options and the code that reads and cleans. Invalid
files are not cached.
"""

from __future__ import annotations

import hashlib
import json
import logging
from functools import cache
from pathlib import Path

from egocap.errors import EgocapError, FileError
from egocap.files import cache_folder, make_folder, read_npz, write_npz
from egocap_sim.motion.clips import load
from egocap_sim.motion.clips.clip_check import ClipReport
from egocap_sim.motion.clips.load import LoadedMotion
from egocap_sim.motion.kinematics.clip import Clip

READERS = (
    "core/bodies.py", "motion/clips/anatomy.py", "motion/clips/bone_calibration.py",
    "motion/clips/bvh.py", "motion/clips/cleaning.py", "motion/clips/clip_check.py",
    "motion/clips/load.py", "motion/clips/npz.py", "motion/clips/skeleton_names.py",
    "motion/kinematics/clip.py", "motion/kinematics/curves.py", "motion/kinematics/figure.py",
)  # fmt: skip
"""The sources that determine the result of reading a file, beside `egocap`'s."""

log = logging.getLogger(__name__)


def stored_clip(
    path: Path, *, up: str | None = None, unit: str | float | None = None, names: Path | None = None
) -> Clip:
    """The clip of `load.load_clip`, with the same errors, from the cache if present."""
    return stored_motion(path, up=up, unit=unit, names=names).clip


def stored_motion(
    path: Path, *, up: str | None = None, unit: str | float | None = None, names: Path | None = None
) -> LoadedMotion:
    """The result of `load.load_motion`, with the same errors, from the cache if present."""
    try:
        kept = _place(path, up, unit, names)
    except OSError:  # raises the error for unreadable files
        return load.load_motion(path, up=up, unit=unit, names=names)
    if kept.exists():
        try:
            return _read(kept, path.stem)
        except (FileError, KeyError, TypeError, ValueError) as error:
            log.warning("%s is damaged (%s); reading %s again", kept, error, path)
    motion = load.load_motion(path, up=up, unit=unit, names=names)
    assert motion.clip.canonical
    try:
        make_folder(kept.parent)
        _write(kept, motion)
    except (EgocapError, OSError) as error:  # only slower without a cache
        log.warning("%s cannot be cached: %s", path.name, error)
    return motion


def _write(kept: Path, motion: LoadedMotion) -> None:
    write_npz(
        kept, compressed=False, fps=motion.clip.fps, report=json.dumps(motion.report.to_dict()),
        positions=motion.clip.positions, rotations=motion.clip.rotations,
        raw_positions=motion.raw.positions, raw_rotations=motion.raw.rotations,
    )  # fmt: skip


def _read(kept: Path, name: str) -> LoadedMotion:
    found = read_npz(kept)
    fps = float(found["fps"])
    clip, raw = (
        Clip(name, fps, found[f"{which}positions"], found[f"{which}rotations"], canonical=True)
        for which in ("", "raw_")
    )
    return LoadedMotion(clip, raw, ClipReport.from_dict(json.loads(str(found["report"]))))


def _place(path: Path, up: str | None, unit: str | float | None, names: Path | None) -> Path:
    digest = hashlib.sha256(f"{_reader()} {path.name} {up} {unit}".encode())
    for file in (path,) if names is None else (path, names):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return cache_folder() / "clips" / f"{digest.hexdigest()[:32]}.npz"


@cache
def _reader() -> str:
    """Fingerprint of the code that reads and cleans."""
    from egocap import geometry
    from egocap.body import skeleton

    folder = Path(__file__).parents[2]
    digest = hashlib.sha256(Path(geometry.__file__).read_bytes())
    digest.update(Path(skeleton.__file__).read_bytes())
    for name in READERS:
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()
