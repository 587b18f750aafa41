"""Which code made a sequence: the version, and a fingerprint of the sources it ran from."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import egocap

_SOURCES = ("*.py", "*.vert", "*.frag", "*.json")

_SHARED = (".", "cameras", "body", "data")  # folders of egocap that the simulator uses


@cache
def code_version() -> str:
    """The version with the first digits of a checksum of the sources that a sequence depends on.

    Two builds of one version whose frames may differ have different code versions.
    """
    digest = hashlib.sha256()
    method = Path(egocap.__file__).parent
    shared = (p for folder in _SHARED for p in (method / folder).glob("*.py"))
    simulator = (p for pattern in _SOURCES for p in Path(__file__).parents[1].rglob(pattern))
    for path in sorted((*shared, *simulator)):
        digest.update(f"{path.parent.name}/{path.name}\0".encode())
        digest.update(path.read_bytes())
    return f"{egocap.__version__}+{digest.hexdigest()[:10]}"
