"""Disk cache of cleaned motion clips, since cleaning a file takes seconds.

The key is a hash of the file's content, the options and the code that reads and cleans. Invalid
files are not cached.
"""

from __future__ import annotations

import hashlib
import logging
from functools import cache
from pathlib import Path

from egocap.errors import EgocapError, FileError
from egocap.files import cache_folder, make_folder, read_npz, write_npz
from egocap_sim.motion.clips import load
from egocap_sim.motion.kinematics.clip import Clip

READERS = (
    "core/bodies.py", "motion/clips/bone_calibration.py", "motion/clips/bvh.py",
    "motion/clips/cleaning.py", "motion/clips/load.py", "motion/clips/npz.py",
    "motion/clips/skeleton_names.py", "motion/kinematics/clip.py", "motion/kinematics/curves.py",
    "motion/kinematics/figure.py",
)  # fmt: skip
"""The sources that determine the result of reading a file."""

log = logging.getLogger(__name__)


def stored_clip(
    path: Path, *, up: str | None = None, unit: str | float | None = None, names: Path | None = None
) -> Clip:
    """The clip of `load.load_clip`, with the same errors, from the cache if present."""
    try:
        kept = _place(path, up, unit, names)
    except OSError:  # raises the error for unreadable files
        return load.load_clip(path, up=up, unit=unit, names=names)
    if kept.exists():
        try:
            found = read_npz(kept)
            fps, positions, rotations = (found[k] for k in ("fps", "positions", "rotations"))
            return Clip(path.stem, float(fps), positions, rotations, canonical=True)
        except (FileError, KeyError) as error:
            log.warning("%s is damaged (%s); reading %s again", kept, error, path)
    clip = load.load_clip(path, up=up, unit=unit, names=names)
    assert clip.canonical
    try:
        make_folder(kept.parent)
        arrays = {"positions": clip.positions, "rotations": clip.rotations}
        write_npz(kept, compressed=False, fps=clip.fps, **arrays)
    except (EgocapError, OSError) as error:  # only slower without a cache
        log.warning("%s cannot be cached: %s", path.name, error)
    return clip


def _place(path: Path, up: str | None, unit: str | float | None, names: Path | None) -> Path:
    digest = hashlib.sha256(f"{_reader()} {path.name} {up} {unit}".encode())
    for file in (path,) if names is None else (path, names):
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return cache_folder() / "clips" / f"{digest.hexdigest()[:32]}.npz"


@cache
def _reader() -> str:
    """Fingerprint of the code that reads and cleans."""
    from egocap import geometry

    folder = Path(__file__).parents[2]
    digest = hashlib.sha256(Path(geometry.__file__).read_bytes())
    for name in READERS:
        digest.update((folder / name).read_bytes())
    return digest.hexdigest()
