"""Draw the episodes of a recording: frames, seed, motion, light and bystanders.

An episode depends only on the seed of the scene and the number of the episode.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from egocap.errors import EgocapError, FileError, InputError
from egocap.files import sha256
from egocap_sim.core.rng import make_rng
from egocap_sim.record.jobs import Job
from egocap_sim.scene.config import EpisodesTable, MotionTable, Scene

KINDS = (".bvh", ".npz")
SPEEDS = (0.8, 1.25)
SUITING: dict[str, tuple[tuple[str, ...], ...]] = {
    "cycle": (("bicycle",),),
    "desk": (("desk", "chair"),),
    "dribble": (("ball",),),
    "hold": (("newspaper",), ("phone",), ("cup",)),
    "juggle": (("juggling_balls",),),
    "sit": (("chair",), ("sofa",)),
    "stairs": (("stairs",),),
    "work": (("counter",),),
}
"""Props of procedural motions, one row for each choice; with other motions `HANDHELD` ones."""
HANDHELD = ("phone", "cup", "controller", "bag")
_STARTS_S = (0.5, 6.0)  # range of start times in a procedural motion
_SPARE_S = 0.5  # of motion beyond the last frame, for late cameras and smoothing
_BLENDED = 0.25  # probability that a clip is joined with another

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ClipFile:
    """A readable motion file."""

    path: str
    seconds: float
    sha256: str


def plan_episodes(scene: Scene, parts: Sequence[int]) -> list[Job]:
    """Plan a recording of `parts[0]` frames, extended by each further part."""
    assert scene.episodes is not None
    least, most = scene.episodes.frames
    jobs: list[Job] = []
    for frames in parts:
        left = frames
        while left:
            rng = make_rng(scene.seed, f"episode {len(jobs)}")
            count = min(int(rng.integers(least, most + 1)), left)
            jobs.append(Job(len(jobs), range(count), int(rng.integers(2**53))))
            left -= count
    return jobs


def draw_episode(scene: Scene, job: Job, clips: Sequence[ClipFile], attempt: int = 0) -> Scene:
    """Draw the scene of one episode; a new `attempt` replaces a draw that cannot be simulated."""
    table = scene.episodes
    assert table is not None
    seed = job.seed + attempt
    rng = make_rng(seed, "episode")
    data = scene.model_dump(exclude_none=True, exclude={"episodes"})
    data |= {"seed": seed, "frames": len(job.frames)}
    data["motion"] = _motion(scene, table, len(job.frames) / scene.fps, clips, rng)
    if rng.random() < table.dusk:
        data["place"]["light"] = "dusk"
    data["others"]["count"] = int(rng.integers(scene.others.count + 1))
    if not scene.things and rng.random() < table.props:
        data["things"] = _props(data["motion"].get("name"), rng)
    return Scene.model_validate(data)


def _props(motion: str | None, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Draw props that suit a motion: its own, or one in each of one or two hands."""
    if motion in SUITING:
        suits = SUITING[motion]
        return [{"kind": kind} for kind in suits[int(rng.integers(len(suits)))]]
    hands = (("left",), ("right",), ("left", "right"))[int(rng.integers(3))]
    return [{"kind": str(rng.choice(HANDHELD)), "hand": hand} for hand in hands]


def _motion(
    scene: Scene,
    table: EpisodesTable,
    seconds: float,
    clips: Sequence[ClipFile],
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Draw the motion table of an episode: a clip or a procedural motion."""
    length = seconds + _SPARE_S
    usable = [clip for clip in clips if clip.seconds > SPEEDS[1] * length + 0.1]
    if usable and rng.random() < table.clip_share:
        return _clip_motion(usable, length, rng)
    motion = scene.motion.model_dump(exclude_none=True)
    if table.motions:
        motion = {"name": table.motions[int(rng.integers(len(table.motions)))]}
    if scene.motion.file is None or table.motions:
        start = float(np.round(rng.uniform(*_STARTS_S), 3))
        motion |= {"start_s": start, "length_s": start + length}
    return motion


def _clip_motion(
    usable: Sequence[ClipFile], length: float, rng: np.random.Generator
) -> dict[str, Any]:
    speed = float(np.round(rng.uniform(*SPEEDS), 3))
    first, second = (usable[int(i)] for i in rng.integers(len(usable), size=2))
    starts = [
        float(np.round(rng.uniform(0, clip.seconds - speed * length - 0.05), 3))
        for clip in (first, second)
    ]
    motion = {
        "file": first.path, "start_s": starts[0], "length_s": length, "speed": speed,
        "mirrored": bool(rng.random() < 0.5),
    }  # fmt: skip
    if rng.random() < _BLENDED:
        motion |= {"then": second.path, "then_start_s": starts[1]}
    return motion


def find_clips(folder: Path, *, strict: bool) -> tuple[ClipFile, ...]:
    """Read the motion files in a folder and its subfolders.

    Skips unreadable files with a warning, and warns of suspect ones (`clip_check`); raises for both
    if `strict`. Raises FileError if none is left.
    """
    from egocap_sim.motion.clips.clip_store import stored_motion

    files = clip_files(folder)
    found: list[ClipFile] = []
    for path in files:
        try:
            motion = stored_motion(path)
        except EgocapError as error:
            if strict:
                raise
            log.warning("skipped: %s", error)
            continue
        clip, report = motion.clip, motion.report
        if report.suspect and strict:
            raise FileError(path, f"suspect: {report.severe_text()}")
        if report.suspect:
            log.warning("%s is suspect: %s", path.name, report.severe_text())
        seconds = (len(clip.positions) - 1) / clip.fps
        found.append(ClipFile(str(path.absolute()), seconds, sha256(path)))
    if not found:
        raise FileError(folder, "none of its motion files can be read")
    minutes = sum(clip.seconds for clip in found) / 60
    log.info("%s: %d of %d motion files, %.1f minutes", folder, len(found), len(files), minutes)
    return tuple(found)


def clip_files(folder: Path) -> list[Path]:
    """Motion files in a folder, sorted. Raises FileError if there are none."""
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a folder of .bvh and .npz files")
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in KINDS and p.is_file())
    if not files:
        raise FileError(folder, "holds no motion files", valid=".bvh, .npz")
    return files


def check_motions(scene: Scene) -> None:
    """Raise InputError for an unknown procedural motion."""
    from egocap_sim.motion.generators.registry import MOTIONS

    assert scene.episodes is not None
    for name in scene.episodes.motions:
        if name not in MOTIONS:
            raise InputError(f"unknown motion '{name}' in [episodes]", valid=MOTIONS)
    MotionTable.model_validate(scene.motion.model_dump(exclude_none=True))
