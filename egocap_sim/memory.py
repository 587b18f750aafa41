"""Give back what a finished episode used."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress


def give_back() -> None:
    """Return freed memory to the system: glibc keeps it, in pieces that grow with every episode.

    Without this a worker holds 3.5 GB after 160 episodes, with it 0.4. Nothing happens where the C
    library is another.
    """
    gc.collect()
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
