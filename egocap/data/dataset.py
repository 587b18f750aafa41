"""Reading data sets: folders of sequences (episodes), each of another person and place.

episodes.json lists the episodes. Each is a sequence folder (episode-00000) with its own rig, body
and truth, written under a temporary name and renamed when complete.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from egocap.data.manifest import MANIFEST, require_folder
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
    bytes: int = Field(gt=0)  # of all its files except the manifest
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")  # of its manifest.json


class Dataset(Strict):
    """episodes.json."""

    kind: Literal["egocap-episodes"] = "egocap-episodes"
    schema_version: int = Field(ge=1)
    name: str
    frames: int = Field(ge=1)  # of all episodes together, when complete
    parts: list[int]  # frames requested at first and with each --append
    seed: int
    config: dict[str, Any]  # everything the content depends on except the number of frames
    config_sha256: str
    code_version: str
    episodes: list[EpisodeEntry] = []

    @property
    def complete(self) -> bool:
        """Whether every episode is recorded."""
        return sum(entry.frames for entry in self.episodes) == self.frames

    @property
    def bytes(self) -> int:
        """Size of the recorded episodes."""
        return sum(entry.bytes for entry in self.episodes)


def episode_name(index: int) -> str:
    """Folder name of an episode."""
    return f"episode-{index:05d}"


def load_dataset(folder: Path) -> Dataset:
    """Read episodes.json of a complete or unfinished data set. Raises FileError."""
    path = folder / EPISODES
    if not path.exists():
        raise FileError(folder, f"not a data set of episodes: it has no {EPISODES}")
    data = read_json(path)
    refuse_newer(data, SCHEMA, path)
    recording = checked(Dataset, data, path)
    indices = [entry.index for entry in recording.episodes]
    if len(set(indices)) < len(indices):
        raise FileError(path, "an episode is listed twice", key="episodes")
    return recording


def find_sequences(folders: Iterable[Path]) -> list[Path]:
    """Find sequences: the folders themselves, or the sequences inside them.

    Hidden folders hold unfinished episodes and are skipped. Raises FileError or InputError where a
    folder is missing or has no sequence.
    """
    found: list[Path] = []
    for folder in folders:
        require_folder(folder)
        if (folder / MANIFEST).exists():
            inside = [folder]
        else:
            inside = sorted(
                path.parent for path in folder.rglob(MANIFEST)
                if not any(part.startswith(".") for part in path.relative_to(folder).parts)
            )  # fmt: skip
        if not inside:
            raise InputError(f"{folder} holds no sequence", valid="output of egocap-sim generate")
        found += inside
    return list(dict.fromkeys(found))
