"""Which code made a sequence: the version, and a fingerprint of the sources it ran from."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import egocap

_SOURCES = ("*.py", "*.vert", "*.frag", "*.json")

_NOUNS = (".", "cameras", "body", "data")  # the rooms of egocap that the simulator uses


@cache
def code_version() -> str:
    """The version with the first digits of the checksum of the sources a sequence depends on.

    Two builds of one version that could draw different frames differ in it; of the method only the
    rooms that the simulator uses count.
    """
    digest = hashlib.sha256()
    method = Path(egocap.__file__).parent
    nouns = (p for room in _NOUNS for p in (method / room).glob("*.py"))
    world = (p for pattern in _SOURCES for p in Path(__file__).parents[1].rglob(pattern))
    for path in sorted((*nouns, *world)):
        digest.update(f"{path.parent.name}/{path.name}\0".encode())
        digest.update(path.read_bytes())
    return f"{egocap.__version__}+{digest.hexdigest()[:10]}"
