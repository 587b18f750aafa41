"""Writing a sequence, crash-safe up to the shards in progress.

Every file is written under a temporary name, synced and renamed, and then listed in the manifest,
which is replaced atomically. One process owns the folder (`egocap.locks`); any number of
worker processes may write shards with `write_shard`.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from pydantic import BaseModel

from egocap.data.manifest import (
    MANIFEST,
    FileEntry,
    Manifest,
    ShardEntry,
    load_manifest,
    shard_name,
)
from egocap.data.truth import Truth
from egocap.errors import FileError, InputError
from egocap.files import replacing, write_atomically
from egocap.locks import IN_FOLDER, OutputLock

_TAR_BLOCK = 512  # bytes; the header of a USTAR member is one block


class SequenceWriter:
    """Creates a sequence folder, or resumes an unfinished one with the same configuration.

    Use as a context manager: it holds the folder's lock. Raises InputError if the folder holds
    other files or another sequence, MachineError if another process is writing it. `begin` writes
    the first files of a new sequence. A run that fails before its first shard leaves nothing of it.
    `manifest` is that on disk but for the files of the frames, which would take memory: a shard
    that is listed has no `frames` here.
    """

    def __init__(
        self,
        folder: Path,
        manifest: Manifest,
        side_files: Mapping[str, bytes],
        *,
        append: bool = False,
    ) -> None:
        """With `append`, a complete sequence of fewer frames is extended: `old_truth` is then its
        truth, and `begin` turns it into an unfinished, longer one."""
        self.folder, self.manifest = folder, manifest
        self.old_truth: Truth | None = None
        self._append, self._longer, self._new = append, False, False
        self._side_files = side_files
        self._before: set[str] = set()
        self._texts: dict[tuple[str, str], str] = {}  # of listed shards, by name and checksum
        self._lock = OutputLock(folder, folder=True)

    def __enter__(self) -> SequenceWriter:
        self._lock.take()
        try:
            if (self.folder / MANIFEST).exists():
                self._resume()
            else:
                refuse_other_files(self.folder, self._side_files)
                self._before = {path.name for path in self.folder.iterdir()}
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None = None, *_: object) -> None:
        if kind is not None and self._new and not self._holds_shards():
            for path in self.folder.iterdir():
                if path.is_file() and path.name not in self._before:
                    path.unlink()
        self._lock.release()

    def begin(self) -> None:
        """Write side files and manifest of a new or extended sequence; no effect when resuming."""
        if not self._longer and (self.folder / MANIFEST).exists():
            return
        entries = {name: _file_entry(content) for name, content in self._side_files.items()}
        manifest = self.manifest.model_copy(update={"files": entries})
        if self._longer:  # first: the complete manifest has checksums of the old files
            self._replace(manifest)
        for name, content in self._side_files.items():
            write_atomically(self.folder / name, content)
        if not self._longer:
            self._replace(manifest)
        self._new, self._longer = not self._longer, False

    def pending(self) -> list[int]:
        """Indices of the shards still to be written."""
        done = {shard.first // self.manifest.shard_frames for shard in self.manifest.shards}
        return [i for i in range(self.manifest.shard_count) if i not in done]

    def shard_range(self, shard: int) -> range:
        """Frame indices of a shard."""
        first = shard * self.manifest.shard_frames
        return range(first, min(first + self.manifest.shard_frames, self.manifest.frames))

    def add_shard(self, entry: ShardEntry) -> None:
        """List a shard written by `write_shard`, after `begin`."""
        assert (self.folder / MANIFEST).exists(), f"{self.folder} was not begun"
        shards = sorted([*self.manifest.shards, entry], key=lambda s: s.first)
        self._replace(self.manifest.model_copy(update={"shards": shards}))

    def write_file(self, name: str, content: bytes) -> None:
        """Write a side file and list it."""
        write_atomically(self.folder / name, content)
        files = self.manifest.files | {name: _file_entry(content)}
        self._replace(self.manifest.model_copy(update={"files": files}))

    def _resume(self) -> None:
        there = load_manifest(self.folder)
        fewer = {"frames": there.frames}
        if self._append and there.complete and there.frames < self.manifest.frames:
            asked = self.manifest.config | fewer
            same = digest(asked)
            require_same_config(self.folder, there, self.manifest.model_copy(
                update={"config": asked, "config_sha256": same}))  # fmt: skip
            self.old_truth, self._longer = Truth.load(self.folder / "truth.npz"), True
            kept = [s for s in there.shards if len(s.frames) == there.shard_frames]
            self.manifest = self.manifest.model_copy(update={"shards": kept})
            return
        require_same_config(self.folder, there, self.manifest)
        for leftover in self.folder.glob("*.tmp"):
            leftover.unlink()
        intact = [shard for shard in there.shards if shard_is_intact(self.folder, shard)]
        files = {k: v for k, v in there.files.items() if file_is_intact(self.folder / k, v)}
        self._replace(there.model_copy(update={"shards": intact, "files": files}))
        for name, content in self._side_files.items():
            if name not in files:
                self.write_file(name, content)

    def _holds_shards(self) -> bool:
        """By the manifest on disk: an interruption may come before `self.manifest` is the same."""
        try:
            return bool(load_manifest(self.folder).shards)
        except FileError:  # changed by others
            return True

    def _replace(self, manifest: Manifest) -> None:
        shards = list(manifest.shards)
        for i, shard in enumerate(shards):
            if (shard.name, shard.sha256) not in self._texts:
                self._texts[shard.name, shard.sha256] = _json(shard)
                shards[i] = shard.model_copy(update={"frames": []})
        text = _json(manifest.model_copy(update={"shards": []}))
        assert text.endswith("[]}"), "shards are not the last field"
        with replacing(self.folder / MANIFEST) as temporary, temporary.open("w") as file:
            file.write(text[:-2])
            for i, shard in enumerate(shards):
                file.write("," * (i > 0) + self._texts[shard.name, shard.sha256])
            file.write("]}")
        self.manifest = manifest.model_copy(update={"shards": shards})


class Configured(Protocol):
    """A manifest of a sequence or data set."""

    config: dict[str, Any]
    config_sha256: str
    code_version: str


def require_same_config(folder: Path, there: Configured, asked: Configured) -> None:
    """Raise InputError unless both have the same options and version of the program."""
    if there.config_sha256 != asked.config_sha256:
        difference = _first_difference(there.config, asked.config)
        raise InputError(
            f"{folder} holds another sequence (it differs in {difference})",
            valid="another --out, or its original options",
        )
    if there.code_version != asked.code_version:
        raise InputError(
            f"{folder} was begun with version {there.code_version}, this is "
            f"{asked.code_version}: their frames may differ",
            valid="another --out, or that version",
        )


def refuse_other_files(folder: Path, own: Iterable[str] = ()) -> None:
    """Raise InputError if the folder holds files other than `own` and temporary ones."""
    names = (path.name for path in folder.iterdir())
    free = (*own, IN_FOLDER)
    other = [name for name in names if not name.endswith(".tmp") and name not in free]
    if other:
        raise InputError(
            f"{folder} holds other files ('{other[0]}')",
            valid="an empty or new folder, or the same unfinished recording",
        )


def write_shard(
    folder: Path, index: int, first: int, frames: Iterable[Mapping[str, bytes]]
) -> ShardEntry:
    """Write the frames of one shard, each a mapping of suffix to bytes, atomically.

    Equal frames give equal bytes. Returns the entry for `SequenceWriter.add_shard`.
    """
    path = folder / shard_name(index)
    ranges: list[dict[str, tuple[int, int]]] = []
    with replacing(path) as temporary, temporary.open("wb") as raw:
        file = _HashingFile(raw)
        with tarfile.open(fileobj=file, mode="w|", format=tarfile.USTAR_FORMAT) as tar:  # pyright: ignore
            for row, frame in enumerate(frames):
                ranges.append({})
                for suffix, data in frame.items():
                    info = tarfile.TarInfo(f"{first + row:06d}.{suffix}")
                    info.size, info.mode = len(data), 0o644
                    ranges[-1][suffix] = (tar.offset + _TAR_BLOCK, len(data))
                    tar.addfile(info, io.BytesIO(data))
    return ShardEntry(
        name=path.name, first=first, bytes=file.size, sha256=file.digest.hexdigest(), frames=ranges
    )


def _json(model: BaseModel) -> str:
    return json.dumps(model.model_dump(mode="json"), indent=None, separators=(",", ":"))


def _file_entry(content: bytes) -> FileEntry:
    return FileEntry(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())


def shard_is_intact(folder: Path, shard: ShardEntry) -> bool:
    """Whether a recorded shard is on disk with its recorded size and checksum."""
    return file_is_intact(folder / shard.name, FileEntry(bytes=shard.bytes, sha256=shard.sha256))


def file_is_intact(path: Path, entry: FileEntry) -> bool:
    """Whether a recorded file is on disk with its recorded size and checksum."""
    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size != entry.bytes:
                return False
            return hashlib.file_digest(file, "sha256").hexdigest() == entry.sha256
    except OSError:
        return False


def digest(config: Mapping[str, Any]) -> str:
    """Checksum of a resolved configuration."""
    return hashlib.sha256(json.dumps(config, sort_keys=True).encode()).hexdigest()


class _HashingFile:
    """A write-only file with running checksum and size."""

    def __init__(self, raw: BinaryIO) -> None:
        self.raw, self.digest, self.size = raw, hashlib.sha256(), 0

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self.size += len(data)
        return self.raw.write(data)


def _first_difference(old: object, new: object, at: str = "") -> str:
    """Describe the first key in which two configurations differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if old.get(key) != new.get(key):
                return _first_difference(old.get(key), new.get(key), f"{at}.{key}" if at else key)
    return f"{at}: {old!r} recorded, {new!r} requested"
