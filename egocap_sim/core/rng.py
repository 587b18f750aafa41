"""Random streams: one for each purpose, so that changing one leaves the others as they were."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The random generator of one purpose under a scene's seed."""
    return np.random.default_rng([seed, zlib.crc32(purpose.encode())])
