"""Give back what a finished episode used."""

from __future__ import annotations

import ctypes
import gc
from contextlib import suppress


def give_back() -> None:
    """Return freed memory to the system: glibc keeps it, in pieces that grow with every episode.

    Without this a worker holds 3.5 GB after 160 episodes, with it 0.4. Nothing happens where the C
    library is another. What the first call finds in use, a quarter of a million objects of modules
    and tables, is there to stay: later ones do not look through it, which would take 0.05 s.
    """
    gc.collect()
    if not gc.get_freeze_count():
        gc.freeze()
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
