"""Recordings to run a command on: names of results, sources, and what tells whether they changed.

In: paths or addresses of sequences, or of footage. Out: a job for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from egocap.data.dataset import find_sequences
from egocap.data.manifest import MANIFEST
from egocap.data.sequence_writer import digest
from egocap.errors import FileError, InputError
from egocap.files import sha256
from egocap.storage.store import Store, is_address


@dataclass(frozen=True)
class Recording:
    """The pictures of one wearer, and what the result is called."""

    index: int
    name: str  # of the result, a file or folder
    sources: tuple[str, ...]  # paths or addresses
    stamp: str  # changes with the content of the sources


def find_recordings(sequences: Iterable[str], ending: str) -> list[Recording]:
    """The sequences, or those inside folders; the results are called like them, with the ending.

    Raises FileError or InputError where a folder is missing or has no sequence, or two of them
    have one name; MachineError for a store without connection.
    """
    found = [one for word in sequences for one in _sequences(word)]
    return list_recordings([(f"{name}{ending}", (source,)) for name, source in found])


def list_recordings(named: Sequence[tuple[str, tuple[str, ...]]]) -> list[Recording]:
    """Recordings by the names of their results, and sources.

    Raises InputError if there are none, or two of a name; FileError for a missing source.
    """
    if not named:
        raise InputError("no recording given", valid="one or more")
    names = [name for name, _ in named]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"two results would be called '{twice[0]}'", valid="different names")
    return [
        Recording(i, name, sources, digest({source: _stamp(source) for source in sources}))
        for i, (name, sources) in enumerate(named)
    ]


def _sequences(word: str) -> list[tuple[str, str]]:
    """Names and places of the sequences of an argument."""
    if not is_address(word):
        top = Path(word)
        return [("-".join((top.resolve().name, *folder.relative_to(top).parts)), str(folder))
                for folder in find_sequences([top])]  # fmt: skip
    store = Store.at(word)
    inside = [PurePosixPath(name).parent for name in sorted(store.listing())
              if PurePosixPath(name).name == MANIFEST]  # fmt: skip
    found = [("-".join((store.name, *folder.parts)), "/".join((word.rstrip("/"), *folder.parts)))
             for folder in inside if not any(p.startswith(".") for p in folder.parts)]  # fmt: skip
    if not found:
        raise FileError(word, "holds no sequence", valid="output of egocap-sim generate")
    return found


def _stamp(source: str) -> Any:
    """Checksum of a sequence's manifest; sizes and times of other files; JSON-ready."""
    if is_address(source):
        return Store.at(source).listing()
    path = Path(source)
    if (path / MANIFEST).is_file():
        return sha256(path / MANIFEST)
    if not path.exists():
        raise FileError(path, "no such file or folder")
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return [[p.name, p.stat().st_size, p.stat().st_mtime_ns] for p in files]
