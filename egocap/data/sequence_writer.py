"""Writing a sequence so that a kill at any instant loses at most the shards in work.

Every file is written under a temporary name, synced and renamed, and only then entered in the
manifest, which is itself replaced atomically. One process owns the folder (an advisory lock on it);
any number of worker processes may write shards for it with `write_shard`.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import tarfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from egocap.data.sequence import (
    MANIFEST,
    FileEntry,
    Manifest,
    ShardEntry,
    Truth,
    load_manifest,
    shard_name,
)
from egocap.errors import InputError, MachineError
from egocap.files import disk_errors, replacing, write_atomically

_TAR_BLOCK = 512  # bytes; the header of a USTAR member is one block


class SequenceWriter:
    """Creates a sequence folder, or takes up an unfinished one of the same configuration.

    Use as a context manager: it holds the folder's lock. Raises InputError when the folder holds
    something else or another sequence, MachineError when another process is writing it. A new
    sequence gets its first files from `begin`: what can fail before should be tried before.
    """

    def __init__(
        self,
        folder: Path,
        manifest: Manifest,
        side_files: Mapping[str, bytes],
        *,
        append: bool = False,
    ) -> None:
        """With `append`, a complete sequence of fewer frames is taken up too: `old_truth` is then
        its truth, and `begin` makes it an unfinished one of more frames."""
        self.folder, self.manifest = folder, manifest
        self.old_truth: Truth | None = None
        self._append, self._longer = append, False
        self._side_files = side_files
        self._lock = FolderLock(folder)

    def __enter__(self) -> SequenceWriter:
        self._lock.take()
        try:
            if (self.folder / MANIFEST).exists():
                self._resume()
            else:
                self._refuse_strangers()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._lock.release()

    def begin(self) -> None:
        """Put the side files and the manifest of a new sequence in place; nothing when resuming."""
        if self._longer:
            self._begin_longer()
        if (self.folder / MANIFEST).exists():
            return
        for name, content in self._side_files.items():
            write_atomically(self.folder / name, content)
        entries = {
            name: FileEntry(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
            for name, content in self._side_files.items()
        }
        self._replace(self.manifest.model_copy(update={"files": entries}))

    def pending(self) -> list[int]:
        """Indices of the shards still to be written."""
        done = {shard.first // self.manifest.shard_frames for shard in self.manifest.shards}
        return [i for i in range(self.manifest.shard_count) if i not in done]

    def frames_of(self, shard: int) -> range:
        """Frame indices of a shard."""
        first = shard * self.manifest.shard_frames
        return range(first, min(first + self.manifest.shard_frames, self.manifest.frames))

    def enter_shard(self, entry: ShardEntry) -> None:
        """Record a shard that `write_shard` has put in place, after `begin`."""
        assert (self.folder / MANIFEST).exists(), f"{self.folder} was not begun"
        shards = sorted([*self.manifest.shards, entry], key=lambda s: s.first)
        self._replace(self.manifest.model_copy(update={"shards": shards}))

    def write_file(self, name: str, content: bytes) -> None:
        """Put a side file in place and record it."""
        write_atomically(self.folder / name, content)
        entry = FileEntry(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
        self._replace(
            self.manifest.model_copy(update={"files": self.manifest.files | {name: entry}})
        )

    def _refuse_strangers(self) -> None:
        strangers = [p.name for p in self.folder.iterdir() if not p.name.endswith(".tmp")]
        strangers = [name for name in strangers if name not in self._side_files]
        if strangers:
            raise InputError(
                f"{self.folder} holds other files ('{strangers[0]}')",
                valid="an empty or new folder, or the same unfinished sequence",
            )

    def _resume(self) -> None:
        there = load_manifest(self.folder)
        fewer = {"frames": there.frames}
        if self._append and there.complete and there.frames < self.manifest.frames:
            asked = self.manifest.config | fewer
            same = digest(asked)
            begun_alike(self.folder, there, self.manifest.model_copy(
                update={"config": asked, "config_sha256": same}))  # fmt: skip
            self.old_truth, self._longer = Truth.load(self.folder / "truth.npz"), True
            kept = [s for s in there.shards if len(s.frames) == there.shard_frames]
            self.manifest = self.manifest.model_copy(update={"shards": kept})
            return
        begun_alike(self.folder, there, self.manifest)
        for leftover in self.folder.glob("*.tmp"):
            leftover.unlink()
        intact = [shard for shard in there.shards if shard_is_intact(self.folder, shard)]
        files = {k: v for k, v in there.files.items() if file_is_intact(self.folder / k, v)}
        self._replace(there.model_copy(update={"shards": intact, "files": files}))
        for name, content in self._side_files.items():
            if name not in files:
                self.write_file(name, content)

    def _begin_longer(self) -> None:
        """Turn the manifest of the complete sequence into that of an unfinished, longer one."""
        entries = {
            name: FileEntry(bytes=len(content), sha256=hashlib.sha256(content).hexdigest())
            for name, content in self._side_files.items()
        }
        self._replace(self.manifest.model_copy(update={"files": entries}))
        for name, content in self._side_files.items():
            write_atomically(self.folder / name, content)
        self._longer = False

    def _replace(self, manifest: Manifest) -> None:
        text = json.dumps(manifest.model_dump(mode="json"), indent=None, separators=(",", ":"))
        write_atomically(self.folder / MANIFEST, text.encode())
        self.manifest = manifest


class FolderLock:
    """The right to write in a folder, which is made where it is missing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = -1
        self._made_folder = False

    def take(self) -> None:
        """Raises MachineError when another process has it."""
        with disk_errors(self.folder):
            self._made_folder = not self.folder.exists()
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.folder, os.O_RDONLY)
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(self._lock)
                raise MachineError(f"{self.folder}: another process is writing it") from None

    def release(self) -> None:
        """Give it back; a folder that was made and is still empty goes."""
        if self._made_folder:
            with suppress(OSError):  # it stays unless it is empty
                self.folder.rmdir()
        os.close(self._lock)


class Begun(Protocol):
    """What tells whether two recordings are the same one."""

    config: dict[str, Any]
    config_sha256: str
    code_version: str


def begun_alike(folder: Path, there: Begun, asked: Begun) -> None:
    """Raise InputError unless what is in the folder was begun with the same options and version."""
    if there.config_sha256 != asked.config_sha256:
        difference = _first_difference(there.config, asked.config)
        raise InputError(
            f"{folder} holds another sequence (it differs in {difference})",
            valid="another --out, or the options it was begun with",
        )
    if there.code_version != asked.code_version:
        raise InputError(
            f"{folder} was begun by version {there.code_version}, this is "
            f"{asked.code_version}: their frames may differ",
            valid="another --out, or that version",
        )


def write_shard(
    folder: Path, index: int, first: int, frames: Iterable[Mapping[str, bytes]]
) -> ShardEntry:
    """Write the frames of one shard, each a mapping of suffix to bytes, and put it in place.

    The same frames give the same bytes. Returns the entry for `SequenceWriter.enter_shard`.
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
    """A write-only file that keeps the checksum and size of what passes through."""

    def __init__(self, raw: BinaryIO) -> None:
        self.raw, self.digest, self.size = raw, hashlib.sha256(), 0

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self.size += len(data)
        return self.raw.write(data)


def _first_difference(old: object, new: object, at: str = "") -> str:
    """Name the first key in which two configurations differ, with both values."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if old.get(key) != new.get(key):
                return _first_difference(old.get(key), new.get(key), f"{at}.{key}" if at else key)
    return f"{at}: {old!r} there, {new!r} asked for"
