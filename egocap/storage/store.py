"""An object store as little as is needed: list, get, put; errors are ours."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

from egocap.errors import FileError, MachineError, require

PROTOCOLS = ("s3", "s3a", "gs", "gcs", "az", "abfs", "hdfs", "sftp", "memory")
_ADDRESS = re.compile(rf"(?:{'|'.join(PROTOCOLS)})://[^/].*")
_VERSIONS = ("ETag", "etag", "md5Hash", "content_md5", "LastModified", "last_modified", "mtime",
             "created")  # fmt: skip
"""Keys by which file systems tell that an object was written again; the first there is used."""

T = TypeVar("T")
Stamp = list[Any]
"""Size in bytes and version of an object, JSON-ready."""


def is_address(word: str) -> bool:
    """Whether a word of a command line names something on a store."""
    return _ADDRESS.fullmatch(word) is not None


@dataclass(frozen=True, eq=False)
class Store:
    """A place on a store: an object, or what lies below it."""

    address: str
    system: Any  # fsspec.AbstractFileSystem
    root: str

    @classmethod
    def at(cls, address: str) -> Store:
        """Raises MachineError without fsspec or the package of the protocol."""
        require("fsspec", "store")
        import fsspec

        try:
            system, root = fsspec.url_to_fs(address)
        except ImportError as error:
            raise MachineError(f"{address}: {error}") from None
        except (ValueError, TypeError) as error:
            raise FileError(address, str(error), valid="PROTOCOL://PLACE/NAME") from None
        return cls(address, system, root.rstrip("/"))

    @property
    def name(self) -> str:
        """Last part of the address."""
        return PurePosixPath(self.root).name

    def listing(self) -> dict[str, Stamp]:
        """Stamps of all objects below by their relative paths; of the object itself by ''.

        Empty where there is nothing. Raises FileError for a path that leads elsewhere.
        """

        def find() -> dict[str, Any]:
            self.system.invalidate_cache()
            return dict(self.system.find(self.root, withdirs=False, detail=True))

        found = self._asked(find)
        return {self._relative(path): stamp(info) for path, info in found.items()}

    def stamp(self, name: str) -> Stamp | None:
        """Stamp of an object; None where there is none."""

        def ask() -> Stamp | None:
            self.system.invalidate_cache()
            try:
                return stamp(self.system.info(self._path(name)))
            except FileNotFoundError:
                return None

        return self._asked(ask)

    def get(self, name: str, path: Path) -> None:
        """Write an object's content to a local file."""
        self._asked(lambda: self.system.get_file(self._path(name), str(path)))

    def put(self, name: str, content: Path | bytes) -> Stamp:
        """Write an object whole; its stamp. Raises MachineError where its size is another."""
        path = self._path(name)
        if isinstance(content, bytes):
            size = len(content)
            self._asked(lambda: self.system.pipe_file(path, content))
        else:
            size = content.stat().st_size
            self._asked(lambda: self.system.put_file(str(content), path))
        written = self.stamp(name)
        if written is None or written[0] != size:
            raise MachineError(f"{self.address}: '{name}' is not as it was sent")
        return written

    def _path(self, name: str) -> str:
        return f"{self.root}/{name}" if name else self.root

    def _relative(self, path: str) -> str:
        path = path.lstrip("/") if not self.root.startswith("/") else path
        if path == self.root:
            return ""
        name = path.removeprefix(f"{self.root}/")
        if name == path or {"", ".", ".."} & set(name.split("/")) or "\\" in name or "\0" in name:
            raise FileError(self.address, f"holds an object '{path}'",
                            valid="names that stay in a folder")  # fmt: skip
        return name

    def _asked(self, call: Callable[[], T]) -> T:
        """The call's result; what any file system raises as errors of ours."""
        try:
            return call()
        except (FileNotFoundError, PermissionError) as error:
            kind = "no such place" if isinstance(error, FileNotFoundError) else "no permission"
            raise FileError(self.address, f"{kind}: {error}") from None
        except Exception as error:  # drivers have exceptions of their own
            raise MachineError(f"{self.address}: {type(error).__name__}: {error}") from None


def stamp(info: dict[str, Any]) -> Stamp:
    """Size and version of what a file system tells of an object."""
    version = next((info[key] for key in _VERSIONS if info.get(key) is not None), "")
    if isinstance(version, float):
        version = datetime.fromtimestamp(version, UTC)
    if isinstance(version, datetime):
        version = version.astimezone(UTC).isoformat()
    return [int(info.get("size") or 0), str(version).strip('"')]
