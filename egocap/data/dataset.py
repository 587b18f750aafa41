"""A recording in episodes, read: a folder of plain sequences, each of another person and place.

episodes.json lists them; each is a folder of its own (episode-00000) that `Sequence` opens like any
other, with its own rig, body and truth. A folder of that name is always whole: it is made under
another and renamed.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from egocap.data.sequence import MANIFEST
from egocap.errors import FileError, InputError
from egocap.schema import Strict, checked, read_json, refuse_newer

SCHEMA = 1
EPISODES = "episodes.json"


class EpisodeEntry(Strict):
    """One finished episode."""

    name: str = Field(pattern=r"^episode-\d{5,}$")
    index: int = Field(ge=0)
    frames: int = Field(ge=1)
    seed: int
    bytes: int = Field(gt=0)  # of all its files but the manifest
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")  # of its manifest.json


class Dataset(Strict):
    """episodes.json."""

    kind: Literal["egocap-episodes"] = "egocap-episodes"
    schema_version: int = Field(ge=1)
    name: str
    frames: int = Field(ge=1)  # of all episodes together, when complete
    parts: list[int]  # frames asked for at first, and appended each time
    seed: int
    config: dict[str, Any]  # everything the content depends on but the number of frames
    config_sha256: str
    code_version: str
    episodes: list[EpisodeEntry] = []

    @property
    def complete(self) -> bool:
        """Whether every episode is there."""
        return sum(entry.frames for entry in self.episodes) == self.frames

    @property
    def bytes(self) -> int:
        """Size of all that is there."""
        return sum(entry.bytes for entry in self.episodes)


def episode_name(index: int) -> str:
    """Folder of an episode."""
    return f"episode-{index:05d}"


def load_dataset(folder: Path) -> Dataset:
    """Read and check episodes.json, of a complete or an unfinished recording."""
    path = folder / EPISODES
    if not path.exists():
        raise FileError(folder, f"not a recording in episodes: it has no {EPISODES}")
    data = read_json(path)
    refuse_newer(data, SCHEMA, path)
    recording = checked(Dataset, data, path)
    indices = [entry.index for entry in recording.episodes]
    if len(set(indices)) < len(indices):
        raise FileError(path, "an episode is there twice", key="episodes")
    return recording


def find_sequences(folders: Iterable[Path]) -> list[Path]:
    """The sequences among folders and, where one is none itself, in the folders within it.

    Those still being made lie in hidden folders and are left out.
    """
    found: list[Path] = []
    for folder in folders:
        if not folder.is_dir():
            raise FileError(folder, "no such folder", valid="sequences, or folders of them")
        if (folder / MANIFEST).exists():
            inside = [folder]
        else:
            inside = sorted(path.parent for path in folder.rglob(MANIFEST))
            inside = [i for i in inside if not _hidden(i.relative_to(folder))]
        if not inside:
            raise InputError(f"{folder} holds no sequence", valid="what egocap-sim generate made")
        found += inside
    return list(dict.fromkeys(found))


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
