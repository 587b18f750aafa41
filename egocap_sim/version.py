"""Which code made a sequence: the version, and a fingerprint of the sources it ran from."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import egocap

_SOURCES = ("*.py", "*.vert", "*.frag", "*.json")


@cache
def code_version() -> str:
    """The version with the first digits of the checksum of the sources a sequence depends on.

    Two builds of one version that could draw different frames differ in it; of the method only the
    nouns at its top count, which is all that the simulator uses.
    """
    digest = hashlib.sha256()
    nouns = Path(egocap.__file__).parent.glob("*.py")
    world = (p for pattern in _SOURCES for p in Path(__file__).parent.rglob(pattern))
    for path in sorted((*nouns, *world)):
        digest.update(f"{path.parent.name}/{path.name}\0".encode())
        digest.update(path.read_bytes())
    return f"{egocap.__version__}+{digest.hexdigest()[:10]}"
