"""Writing a recording in episodes: a kill at any instant loses at most the episodes in work.

One process owns the folder and enters what is there; others make episodes under hidden names, and
rename them when they are whole.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from pathlib import Path

from egocap.data.dataset import EPISODES, Dataset, EpisodeEntry, episode_name, load_dataset
from egocap.data.sequence import MANIFEST, load_manifest
from egocap.data.sequence_writer import FolderLock, begun_alike
from egocap.errors import InputError
from egocap.files import disk_errors, write_atomically


class DatasetWriter:
    """Creates a recording, or takes up one of the same configuration.

    Use as a context manager: it holds the folder's lock. With `append`, a recording of fewer frames
    is taken up too, and made longer. Raises as `SequenceWriter` does.
    """

    def __init__(self, folder: Path, recording: Dataset, *, append: bool) -> None:
        self.folder, self.recording = folder, recording
        self._append = append
        self._lock = FolderLock(folder)

    def __enter__(self) -> DatasetWriter:
        self._lock.take()
        try:
            if (self.folder / EPISODES).exists():
                self._resume()
            else:
                strangers = [p.name for p in self.folder.iterdir() if not p.name.endswith(".tmp")]
                if strangers:
                    raise InputError(
                        f"{self.folder} holds other files ('{strangers[0]}')",
                        valid="an empty or new folder, or the same unfinished recording",
                    )
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._lock.release()

    def begin(self) -> None:
        """Put the list in place."""
        self._replace(self.recording)

    def done(self) -> set[int]:
        """Indices of the episodes that are there."""
        return {entry.index for entry in self.recording.episodes}

    def enter(self, entry: EpisodeEntry) -> None:
        """Record an episode that is in place."""
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
                f"{self.folder} holds a recording of {there.frames} frames, not {asked.frames}",
                valid=f"{longer}another --out",
            )
        begun_alike(self.folder, there, asked)
        for leftover in self.folder.glob(".*.tmp"):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)  # a worker may be about to die in it
            else:
                leftover.unlink(missing_ok=True)
        known = {entry.index: entry for entry in there.episodes}
        for folder in self.folder.glob("episode-*"):
            index = int(folder.name.removeprefix("episode-"))
            entry = episode_entry(folder, index)  # renamed, perhaps, but not entered yet
            if entry is None or known.get(index, entry) != entry:
                known.pop(index, None)
            else:
                known[index] = entry
        present = [e for e in known.values() if (self.folder / e.name / MANIFEST).exists()]
        self.recording = asked.model_copy(
            update={
                "frames": sum(parts),
                "parts": parts,
                "episodes": sorted(present, key=lambda e: e.index),
            }
        )

    def _replace(self, recording: Dataset) -> None:
        text = json.dumps(recording.model_dump(mode="json"), separators=(",", ":"))
        write_atomically(self.folder / EPISODES, text.encode())
        self.recording = recording


def episode_entry(folder: Path, index: int) -> EpisodeEntry | None:
    """The entry of an episode's folder; None unless every file is there in its recorded size."""
    if not (folder / MANIFEST).exists():
        return None
    manifest = load_manifest(folder)
    sizes = {shard.name: shard.bytes for shard in manifest.shards}
    sizes |= {name: file.bytes for name, file in manifest.files.items()}
    whole = manifest.complete and all(
        (folder / name).exists() and (folder / name).stat().st_size == size
        for name, size in sizes.items()
    )
    if not whole:
        return None
    return EpisodeEntry(
        name=episode_name(index),
        index=index,
        frames=manifest.frames,
        seed=manifest.seed,
        bytes=sum(sizes.values()),
        sha256=hashlib.sha256((folder / MANIFEST).read_bytes()).hexdigest(),
    )


def put_in_place(made: Path, folder: Path) -> None:
    """Give an episode that is whole its name; one that is there under it is replaced."""
    with disk_errors(folder):
        if folder.exists():
            shutil.rmtree(folder)
        made.rename(folder)
        parent = os.open(folder.parent, os.O_RDONLY)
        try:
            os.fsync(parent)
        finally:
            os.close(parent)
