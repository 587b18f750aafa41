"""Writing a data set of episodes, crash-safe up to the episodes in progress.

One process owns the folder and lists finished episodes; worker processes write episodes under
hidden names and rename them when they are complete.
"""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from egocap.data.dataset import EPISODES, Dataset, EpisodeEntry, episode_name, load_dataset
from egocap.data.manifest import MANIFEST, load_manifest
from egocap.data.sequence_writer import (
    file_is_intact,
    refuse_other_files,
    require_same_config,
    shard_is_intact,
)
from egocap.errors import FileError, InputError
from egocap.files import disk_errors, sha256, write_atomically
from egocap.locks import OutputLock

log = logging.getLogger(__name__)


class DatasetWriter:
    """Creates a data set, or resumes one with the same configuration.

    Use as a context manager: it holds the folder's lock. With `append`, a data set of fewer frames
    is extended. Raises as `SequenceWriter`.
    """

    def __init__(self, folder: Path, recording: Dataset, *, append: bool) -> None:
        self.folder, self.recording = folder, recording
        self._append = append
        self._lock = OutputLock(folder, folder=True)

    def __enter__(self) -> DatasetWriter:
        self._lock.take()
        try:
            if (self.folder / EPISODES).exists():
                self._resume()
            else:
                refuse_other_files(self.folder)
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._lock.release()

    def begin(self) -> None:
        """Write episodes.json."""
        self._replace(self.recording)

    def done(self) -> set[int]:
        """Indices of the recorded episodes."""
        return {entry.index for entry in self.recording.episodes}

    def add(self, entry: EpisodeEntry) -> None:
        """List a finished episode."""
        entries = sorted([*self.recording.episodes, entry], key=lambda e: e.index)
        self._replace(self.recording.model_copy(update={"episodes": entries}))

    def _resume(self) -> None:
        there, asked = load_dataset(self.folder), self.recording
        parts = there.parts
        if asked.frames > there.frames and self._append:
            parts = [*parts, asked.frames - there.frames]
        elif asked.frames != there.frames:
            longer = "more frames with --append, or " if asked.frames > there.frames else ""
            raise InputError(
                f"{self.folder} holds a data set of {there.frames} frames, not {asked.frames}",
                valid=f"{longer}another --out",
            )
        require_same_config(self.folder, there, asked)
        for leftover in self.folder.glob(".*.tmp"):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)  # a worker may still write
            else:
                leftover.unlink(missing_ok=True)
        self.recording = asked.model_copy(
            update={"frames": sum(parts), "parts": parts, "episodes": self._intact(there)}
        )

    def _intact(self, there: Dataset) -> list[EpisodeEntry]:
        """Undamaged episodes, also those that were renamed but not yet listed."""
        known = {entry.index: entry for entry in there.episodes}
        folders = {int(name[1]): path for path in self.folder.iterdir()
                   if (name := re.fullmatch(r"episode-(\d{5,})", path.name))}  # fmt: skip
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # checksums are computed in parallel
            entries = dict(zip(folders, pool.map(episode_entry, folders.values(), folders),
                               strict=True))  # fmt: skip
        intact = {i: e for i, e in entries.items() if e is not None and known.get(i, e) == e}
        for index in sorted(folders.keys() - intact.keys()):
            log.warning("%s is incomplete or damaged; it is made again", folders[index])
        return [intact[index] for index in sorted(intact)]

    def _replace(self, recording: Dataset) -> None:
        text = json.dumps(recording.model_dump(mode="json"), separators=(",", ":"))
        write_atomically(self.folder / EPISODES, text.encode())
        self.recording = recording


def episode_entry(folder: Path, index: int) -> EpisodeEntry | None:
    """Entry of an episode's folder; None unless every file has its recorded checksum."""
    try:
        manifest = load_manifest(folder)
    except FileError:
        return None
    whole = all(shard_is_intact(folder, shard) for shard in manifest.shards) and all(
        file_is_intact(folder / name, file) for name, file in manifest.files.items()
    )
    if not (whole and manifest.complete):
        return None
    return EpisodeEntry(
        name=episode_name(index),
        index=index,
        frames=manifest.frames,
        seed=manifest.seed,
        bytes=sum(part.bytes for part in (*manifest.shards, *manifest.files.values())),
        sha256=sha256(folder / MANIFEST),
    )


def replace_episode(made: Path, folder: Path) -> None:
    """Rename a complete episode to its final name, replacing an existing one."""
    with disk_errors(folder):
        if folder.exists():
            shutil.rmtree(folder)
        made.rename(folder)
        parent = os.open(folder.parent, os.O_RDONLY)
        try:
            os.fsync(parent)
        finally:
            os.close(parent)
