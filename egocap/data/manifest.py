"""manifest.json of a sequence: its settings, and the byte range of every file in every shard.

Version 2: a sequence may be footage, without truth, at the times of `times.npz`, and its pictures
may lie in videos or folders elsewhere.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from egocap.errors import FileError
from egocap.schema import Strict, checked, read_json, refuse_newer

SCHEMA = 2
MANIFEST = "manifest.json"


class ShardEntry(Strict):
    """One shard: its checksum, and the byte range of every file of its frames."""

    name: str = Field(pattern=r"^shard-\d{5}\.tar$")
    first: int = Field(ge=0)  # index of its first frame
    bytes: int = Field(gt=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    frames: list[dict[str, tuple[int, int]]]  # for each frame: suffix -> (offset, size)


class FileEntry(Strict):
    """Size and checksum of a side file."""

    bytes: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Manifest(Strict):
    """manifest.json. Units are metres, radians, seconds and pixels throughout."""

    kind: Literal["egocap-sequence"] = "egocap-sequence"
    schema_version: int = Field(ge=1)
    name: str
    units: dict[str, str] = {"length": "m", "angle": "rad", "time": "s", "image": "px"}
    fps: float = Field(gt=0)
    frames: int = Field(ge=1)
    shard_frames: int = Field(ge=1)
    views: tuple[Annotated[str, Field(pattern=r"^[\w-]{1,40}$")], ...]
    seed: int
    truth: bool = True  # footage has none
    shards_hold_images: bool = True  # otherwise they stay in the files that footage.json names
    config: dict[str, Any]  # everything the content depends on, resolved
    config_sha256: str
    code_version: str
    files: dict[Annotated[str, Field(pattern=r"^\w[\w.-]*$")], FileEntry] = {}
    shards: list[ShardEntry] = []

    @property
    def shard_count(self) -> int:
        """Number of shards of the complete sequence."""
        return -(-self.frames // self.shard_frames) if self.shards_hold_images else 0

    @property
    def complete(self) -> bool:
        """Whether every shard is recorded, and the truth or the times of footage."""
        return len(self.shards) == self.shard_count and self.last_file in self.files

    @property
    def last_file(self) -> str:
        """The file without which no sequence is complete."""
        return "truth.npz" if self.truth else "times.npz"


def require_folder(folder: Path) -> None:
    """Raise FileError unless a folder of sequences is there."""
    if folder.is_file():
        raise FileError(folder, "a file, not the folder of a sequence",
                        valid="of videos, `egocap import` makes a sequence")  # fmt: skip
    if not folder.is_dir():
        raise FileError(folder, "no such folder", valid="a sequence, or a folder of them")


def load_manifest(folder: Path) -> Manifest:
    """Read manifest.json of a complete or unfinished sequence. Raises FileError."""
    path = folder / MANIFEST
    require_folder(folder)
    if not path.exists():
        if (folder / "episodes.json").exists():
            raise FileError(folder, "holds a data set of several sequences",
                            valid=f"one of them, e.g. {folder}/episode-00000")  # fmt: skip
        raise FileError(folder, f"not a sequence: it has no {MANIFEST}")
    data = read_json(path)
    refuse_newer(data, SCHEMA, path)
    manifest = checked(Manifest, data, path)
    _check_index(manifest, path)
    return manifest


def _check_index(manifest: Manifest, path: Path) -> None:
    if len(manifest.shards) > manifest.shard_count:
        raise FileError(path, f"lists {len(manifest.shards)} shards for {manifest.frames} frames",
                        key="shards", valid=f"at most {manifest.shard_count}")  # fmt: skip
    last = -1
    for i, shard in enumerate(manifest.shards):
        index, rest = divmod(shard.first, manifest.shard_frames)
        expected = min(manifest.shard_frames, manifest.frames - shard.first)
        if rest or len(shard.frames) != expected or shard.name != shard_name(index):
            raise FileError(
                path, f"entry of {shard.name} does not fit the frame count", key=f"shards.{i}"
            )
        if index <= last:  # shards are indexed by position
            raise FileError(path, f"{shard.name} is repeated or out of order", key=f"shards.{i}")
        last = index


def shard_name(index: int) -> str:
    """File name of a shard."""
    return f"shard-{index:05d}.tar"
