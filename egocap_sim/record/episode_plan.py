"""What each episode of a recording is: its frames, seed, motion, light and company.

All of it follows from the scene's seed and the episode's number alone.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from egocap.errors import EgocapError, FileError, InputError
from egocap_sim.core.rng import stream
from egocap_sim.scene.config import EpisodesTable, MotionTable, Scene

KINDS = (".bvh", ".npz")
SPEEDS = (0.8, 1.25)
_STARTS_S = (0.5, 6.0)  # where in a procedural motion an episode begins
_SPARE_S = 0.5  # of motion beyond the last frame: for late cameras and for the smoothing
_BLENDED = 0.25  # share of the clips that pass into another

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Episode:
    """One episode: its place in the recording, how long it is, and what it is drawn from."""

    index: int
    frames: int
    seed: int


@dataclass(frozen=True)
class Recorded:
    """A motion file that can be used."""

    path: str
    seconds: float
    sha256: str


def plan(scene: Scene, parts: Sequence[int]) -> list[Episode]:
    """The episodes of a recording of so many frames, and as many more as it was continued by."""
    assert scene.episodes is not None
    least, most = scene.episodes.frames
    episodes: list[Episode] = []
    for frames in parts:
        left = frames
        while left:
            index = len(episodes)
            rng = stream(scene.seed, f"episode {index}")
            count = min(int(rng.integers(least, most + 1)), left)
            episodes.append(Episode(index, count, int(rng.integers(2**53))))
            left -= count
    return episodes


def scene_of(scene: Scene, episode: Episode, clips: Sequence[Recorded], attempt: int = 0) -> Scene:
    """The scene of one episode. Another `attempt` draws anew, for what turned out impossible."""
    table = scene.episodes
    assert table is not None
    seed = episode.seed + attempt
    rng = stream(seed, "episode")
    data = scene.model_dump(exclude_none=True, exclude={"episodes"})
    data |= {"seed": seed, "frames": episode.frames}
    data["motion"] = _motion(scene, table, episode.frames / scene.fps, clips, rng)
    if rng.random() < table.dusk:
        data["place"]["light"] = "dusk"
    data["others"]["count"] = int(rng.integers(scene.others.count + 1))
    return Scene.model_validate(data)


def _motion(
    scene: Scene,
    table: EpisodesTable,
    seconds: float,
    clips: Sequence[Recorded],
    rng: np.random.Generator,
) -> dict[str, Any]:
    length = seconds + _SPARE_S
    usable = [clip for clip in clips if clip.seconds > SPEEDS[1] * length + 0.1]
    if usable and rng.random() < table.clip_share:
        speed = float(np.round(rng.uniform(*SPEEDS), 3))
        first, second = (usable[int(i)] for i in rng.integers(len(usable), size=2))
        starts = [float(np.round(rng.uniform(0, clip.seconds - speed * length - 0.05), 3))
                  for clip in (first, second)]  # fmt: skip
        motion = {"file": first.path, "start_s": starts[0], "length_s": length, "speed": speed,
                  "mirrored": bool(rng.random() < 0.5)}  # fmt: skip
        if rng.random() < _BLENDED:
            motion |= {"then": second.path, "then_start_s": starts[1]}
        return motion
    motion = scene.motion.model_dump(exclude_none=True)
    if table.motions:
        motion = {"name": table.motions[int(rng.integers(len(table.motions)))]}
    if scene.motion.file is None or table.motions:
        start = float(np.round(rng.uniform(*_STARTS_S), 3))
        motion |= {"start_s": start, "length_s": start + length}
    return motion


def catalogue(folder: Path, *, strict: bool) -> tuple[Recorded, ...]:
    """The motion files in a folder and the folders within it.

    Raises FileError where there are none; a file that cannot be read is left out with a warning or,
    where `strict`, an error.
    """
    from egocap_sim.motion.clips.clip_store import stored_clip

    files = clip_files(folder)
    found: list[Recorded] = []
    for path in files:
        try:
            clip = stored_clip(path)
        except EgocapError as error:
            if strict:
                raise
            log.warning("left out: %s", error)
            continue
        seconds = (len(clip.positions) - 1) / clip.fps
        found.append(Recorded(str(path.absolute()), seconds, checksum(path)))
    if not found:
        raise FileError(folder, "none of its motion files can be used")
    minutes = sum(clip.seconds for clip in found) / 60
    log.info("%s: %d of %d motion files, %.1f minutes", folder, len(found), len(files), minutes)
    return tuple(found)


def clip_files(folder: Path) -> list[Path]:
    """Motion files in a folder, by name. Raises FileError where there are none."""
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a folder of .bvh and .npz files")
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in KINDS and p.is_file())
    if not files:
        raise FileError(folder, "holds no motion files", valid=".bvh, .npz")
    return files


def checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_motions(scene: Scene) -> None:
    """Raise InputError for an unknown procedural motion."""
    from egocap_sim.motion.generators.registry import MOTIONS

    assert scene.episodes is not None
    for name in scene.episodes.motions:
        if name not in MOTIONS:
            raise InputError(f"unknown motion '{name}' in [episodes]", valid=MOTIONS)
    MotionTable.model_validate(scene.motion.model_dump(exclude_none=True))
