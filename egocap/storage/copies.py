"""The local copy of a place on a store: fetched before it is read, sent while it is written.

A sequence or data set is sent in the order in which it is written, the files that an index names
before the index. What lies on the store is complete up to its last index at any moment.
"""

from __future__ import annotations

import hashlib
import logging
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from egocap.commandline import progress, repeated
from egocap.errors import EgocapError, FileError, MachineError
from egocap.files import cache_folder, make_folder, replacing, sha256, write_json
from egocap.locks import IN_FOLDER, HeldError, holding
from egocap.schema import parsed, read_json
from egocap.storage.store import Stamp, Store, is_address

log = logging.getLogger(__name__)

INDICES = ("manifest.json", "episodes.json")
"""Files that name others, innermost first."""
EVERY_S = 1.0
PATIENCE_S = 900.0
"""How long a store that does not answer is asked again at the end."""
_LONGEST_WAIT_S = 30.0
_AT_ONCE = 4  # transfers
_IDLE_SHARE = 5.0  # of the time of a pass over the copy, before the next

P = TypeVar("P", str, Path)


@dataclass(frozen=True)
class _Index:
    """An index as it was read at one moment."""

    name: str
    here: Stamp
    content: bytes
    names: tuple[str, ...]  # of the files that it lists


class Copy:
    """A place on a store and its local copy in the cache, of one process at a time (`held`)."""

    def __init__(self, address: str) -> None:
        self.store = Store.at(address)
        key = hashlib.sha256(address.rstrip("/").encode()).hexdigest()[:16]
        self._folder = cache_folder() / "stores" / key
        self.path = self._folder / (self.store.name or "root")
        self._state = self._folder / "state.json"
        self._known: dict[str, dict[str, Any]] = {}
        """By relative path: the object's stamp, and the local file's, when they were equal."""

    @contextmanager
    def held(self) -> Iterator[Copy]:
        """Keep other processes of this machine from the copy. Raises MachineError if one has it."""
        with holding(self._folder, folder=True):
            self._known = self._load()
            try:
                yield self
            finally:
                write_json(self._state, {"address": self.store.address, "files": self._known})

    def fetch(self, *, keep_unsent: bool = False) -> bool:
        """Bring the copy up to date; whether there is anything on the store.

        With `keep_unsent`, what was written here since and not there stays. Files that a manifest
        lists must have its checksums. Raises FileError, MachineError.
        """
        there = {name: s for name, s in self.store.listing().items() if not _passing(name)}
        if ("" in there and self.path.is_dir()) or (there.keys() - {""} and self.path.is_file()):
            raise FileError(self.store.address, f"is another kind of thing than {self.path}",
                            valid=f"that place, after {self.path} is removed")  # fmt: skip
        stale = [n for n, found in there.items() if not self._is_current(n, found, keep_unsent)]
        if there and not keep_unsent:
            for name in self._known.keys() - there.keys():  # the store has them no more
                self._local(name).unlink(missing_ok=True)
                del self._known[name]
        # An index last: an interrupted fetch leaves no index of files that are not there.
        stale.sort(key=lambda name: (_rank(name), name))
        if stale:
            with progress("fetch", len(stale), unit="files") as advance:
                for names in _alike(stale):
                    with ThreadPoolExecutor(_AT_ONCE) as pool:
                        for _ in pool.map(lambda name: self._get(name, there[name]), names):
                            advance(1)
            self._check(stale)
        return bool(there)

    def send(self) -> int:
        """Send what is new in the copy; the number of files. Raises FileError, MachineError."""
        if self.path.is_file():
            return self._put([""])
        if not self.path.is_dir():
            return 0
        sent = 0
        for index in self._indices():  # all are read before anything is sent
            sent += self._put([n for n in index.names if self._local(n).is_file()])
            sent += self._put_index(index)
        files = (self._name(path) for path in sorted(self.path.rglob("*")) if path.is_file())
        return sent + self._put([n for n in files if not _passing(n) and _rank(n) == 0])

    def send_all(self) -> int:
        """`send`, again and again while the store does not answer, up to `PATIENCE_S`.

        Raises MachineError where it still does not; the copy is kept.
        """
        wait, until = 1.0, time.monotonic() + PATIENCE_S
        while True:
            try:
                self._forget_lost()
                return self.send()
            except MachineError as error:
                if time.monotonic() + wait > until:
                    raise MachineError(
                        f"{error}", remedy=f"the files are in {self.path}: run the same command "
                        "again to send them"
                    ) from None  # fmt: skip
                log.warning("%s; asked again in %.0f s", error, wait)
                time.sleep(wait)
                wait = min(2.0 * wait, _LONGEST_WAIT_S)

    @contextmanager
    def sending(self) -> Iterator[None]:
        """Send finished files every second meanwhile, on a thread."""
        said, spent = False, 0.0

        def send() -> None:
            nonlocal said, spent
            start = time.monotonic()
            try:
                self.send()
                said = False
            except EgocapError as error:
                if not said:
                    log.warning("%s; it is tried again", error)
                said = True
            spent = time.monotonic() - start

        with repeated(send, lambda: max(EVERY_S, _IDLE_SHARE * spent)):
            yield

    def _indices(self) -> list[_Index]:
        """Innermost first; outer ones are read first, so that they list nothing that is newer."""
        found = []
        for last in reversed(INDICES):
            for path in sorted(self.path.rglob(last), reverse=True):
                here, name = _stamp(path), self._name(path)
                if here is None or _passing(name) or self._is_sent(name):
                    continue
                content = path.read_bytes()
                listed = _listed(parsed(content, path)) if _rank(name) == 1 else []
                names = tuple(self._name(path.parent / one) for one, _ in listed)
                found.append(_Index(name, here, content, names))
        return found[::-1]

    def _name(self, path: Path) -> str:
        return path.relative_to(self.path).as_posix()

    def _local(self, name: str) -> Path:
        return self.path / name if name else self.path

    def _is_current(self, name: str, found: Stamp, keep_unsent: bool) -> bool:
        known, here = self._known.get(name), _stamp(self._local(name))
        if known is None or here is None or known["there"] != found:
            return False
        return keep_unsent or known["here"] == here

    def _get(self, name: str, found: Stamp) -> None:
        path = self._local(name)
        make_folder(path.parent)
        with replacing(path) as temporary:
            self.store.get(name, temporary)
        self._known[name] = {"there": found, "here": _stamp(path)}

    def _put(self, names: list[str]) -> int:
        """Send the files that the store does not have."""

        def put(name: str) -> None:
            here = _stamp(self._local(name))
            there = self.store.put(name, self._local(name))
            self._known[name] = {"there": there, "here": here}

        new = [name for name in names if not self._is_sent(name)]
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            list(pool.map(put, new))
        return len(new)

    def _put_index(self, index: _Index) -> int:
        """Replace an index; FileError where it is no longer as it was left from here."""
        known = self._known.get(index.name)
        if known is not None and self.store.stamp(index.name) not in (None, known["there"]):
            raise FileError(self.store.address, f"'{index.name}' was written by another process",
                            valid="one writer for a place")  # fmt: skip
        there = self.store.put(index.name, index.content)
        self._known[index.name] = {"there": there, "here": index.here}
        return 1

    def _is_sent(self, name: str) -> bool:
        known = self._known.get(name)
        return known is not None and known["here"] == _stamp(self._local(name))

    def _forget_lost(self) -> None:
        """Forget what the store had and has no more, so that it is sent again."""
        there = self.store.listing()
        self._known = {n: k for n, k in self._known.items() if there.get(n) == k["there"]}

    def _check(self, fetched: list[str]) -> None:
        """Compare fetched files with the checksums of the manifests beside them."""
        if not self.path.is_dir():
            return
        new = set(fetched)
        for manifest in sorted(self.path.rglob("manifest.json")):
            for name, entry in _listed(read_json(manifest)):
                path = manifest.parent / name
                whole = path.is_file() and path.stat().st_size == entry.get("bytes")
                if self._name(path) in new and not (whole and sha256(path) == entry.get("sha256")):
                    self._known.pop(self._name(path), None)
                    raise FileError(self.store.address, f"'{self._name(path)}' is not as its "
                                    "manifest says: damaged, or being written")  # fmt: skip

    def _load(self) -> dict[str, dict[str, Any]]:
        if not self._state.exists():
            return {}
        try:
            found = read_json(self._state)["files"]
            return {name: {"there": k["there"], "here": k["here"]} for name, k in found.items()}
        except (EgocapError, KeyError, TypeError, AttributeError):
            log.warning("%s is damaged: everything is compared anew", self._state)
            return {}


def _rank(name: str) -> int:
    """0 of a file, 1 of a manifest, 2 of an index of episodes."""
    last = name.rpartition("/")[2]
    return 1 + INDICES.index(last) if last in INDICES else 0


def _alike(names: list[str]) -> Iterator[list[str]]:
    for rank in range(1 + len(INDICES)):
        yield [name for name in names if _rank(name) == rank]


def _passing(name: str) -> bool:
    """Whether a file, or a folder above it, is temporary or a lock."""
    return any(part == IN_FOLDER or part.startswith(".") or part.endswith(".tmp")
               for part in name.split("/"))  # fmt: skip


def _stamp(path: Path) -> Stamp | None:
    """Size and time of writing of a local file."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return None
    return [found.st_size, found.st_mtime_ns]


def _listed(manifest: Any) -> list[tuple[str, dict[str, Any]]]:
    """Names and entries of the files and shards of a manifest; none of another file."""
    if not isinstance(manifest, dict):
        return []
    files, shards = manifest.get("files", {}), manifest.get("shards", [])
    if not isinstance(files, dict) or not isinstance(shards, list):
        return []
    found = [(name, e) for name, e in files.items() if isinstance(e, dict)]
    found += [(str(e.get("name")), e) for e in shards if isinstance(e, dict)]
    return [(name, e) for name, e in found if "/" not in name and "\\" not in name]


def fetch(address: str) -> Path:
    """The local copy of a file or folder on a store, brought up to date.

    Raises FileError where there is nothing, or a file is damaged; MachineError without connection.
    """
    with Copy(address).held() as copy:
        if not copy.fetch():
            raise FileError(address, "there is nothing there")
        return copy.path


def here(path: P) -> P:
    """The path or word itself, or the local copy of what it names on a store. Raises as `fetch`.

    Processes of this machine that fetch the same wait for each other.
    """
    address = re.sub(r"^(\w+):/(?=[^/])", r"\1://", str(path))  # a Path drops a slash
    while is_address(address):
        try:
            return type(path)(fetch(address))
        except HeldError:
            time.sleep(EVERY_S)
    return path
