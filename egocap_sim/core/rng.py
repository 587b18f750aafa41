"""Random generators: one for each purpose, so that a change of one leaves the others unchanged."""

from __future__ import annotations

import zlib

import numpy as np


def make_rng(seed: int, purpose: str) -> np.random.Generator:
    """The random generator of one purpose under a scene's seed."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
