"""Dataclasses of arrays with one row a frame, kept in npz files."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np

from egocap.errors import FileError


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """Base of records whose fields are all arrays of the same length T."""

    def save(self, path: Path) -> None:
        """Write an npz file (uncompressed, the same bytes every time)."""
        with path.open("wb") as file:
            self._write(file)

    def content(self) -> bytes:
        """What `save` writes."""
        file = io.BytesIO()
        self._write(file)
        return file.getvalue()

    def _write(self, file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for field in fields(self):
                entry = zipfile.ZipInfo(field.name + ".npy", date_time=(1980, 1, 1, 0, 0, 0))
                with archive.open(entry, "w") as member:
                    np.lib.format.write_array(member, getattr(self, field.name), allow_pickle=False)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote; FileError when an array is missing or of another length."""
        try:
            with np.load(path, allow_pickle=False) as data:
                missing = [f.name for f in fields(cls) if f.name not in data]
                if missing:
                    raise FileError(path, "array missing", key=missing[0])
                record = cls(**{f.name: data[f.name] for f in fields(cls)})
        except (OSError, ValueError, zipfile.BadZipFile, EOFError) as error:
            raise FileError(path, f"not a readable truth file: {error}") from None
        lengths = {f.name: len(getattr(record, f.name)) for f in fields(cls)}
        frames = next(iter(lengths.values()))
        for name, length in lengths.items():
            if length != frames:
                raise FileError(path, f"has {length} rows, not {frames}", key=name)
        return record
