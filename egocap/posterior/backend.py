"""An emcee backend in one npz file, written whole, so that a kill loses little and tears nothing.

The file holds the chain, its log probabilities, the acceptance counts, the random state and a
fingerprint of what is being sampled. No pickles.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from emcee.backends import Backend
from jaxtyping import Float, UInt32
from numpy import ndarray as Array

from egocap.data.arrays import record_of
from egocap.errors import FileError
from egocap.files import read_npz, write_npz

KIND = "egocap-chain"
EVERY_S = 5.0
"""Seconds between two writes of the file."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The file's arrays: S steps of W walkers, and the random state of MT19937."""

    kind: str
    fingerprint: str
    chain: Float[Array, "S W N"]
    log_prob: Float[Array, "S W"]
    accepted: Float[Array, "W"]
    keys: UInt32[Array, "624"]
    position: int
    gauss: Float[Array, "2"]  # whether there is a second normal number, and that number


def read_chain(path: Path) -> Chain:
    """Read a chain's file. Raises FileError unless it holds a chain and a random state."""
    found = read_npz(path)
    if str(found.get("kind")) != KIND:
        raise FileError(path, "not a chain of this sampler")
    there = record_of(path, Chain, found)
    if not 0 <= there.position <= len(there.keys) or not np.isfinite(there.gauss).all():
        raise FileError(path, "not a random state", key="position")
    return there


class NpzBackend(Backend):
    """Keeps the chain in memory and copies it to a file now and then, and on `save`.

    An existing file is taken up; FileError when it is damaged or of another fingerprint.
    """

    def __init__(self, path: str | Path, fingerprint: str, every_s: float = EVERY_S) -> None:
        super().__init__()
        self.path, self.fingerprint, self.every_s = Path(path), fingerprint, every_s
        self._saved = time.monotonic()
        if self.path.exists():
            self._load()

    def save_step(self, state: Any, accepted: Any) -> None:
        """Store a step; the file follows when it is old enough."""
        super().save_step(state, accepted)
        if time.monotonic() - self._saved >= self.every_s:
            self.save()

    def save(self) -> None:
        """Write the file now, whole or not at all."""
        _, keys, position, has_gauss, gauss = self.random_state
        write_npz(
            self.path, compressed=False, kind=KIND, fingerprint=self.fingerprint,
            chain=self.chain[: self.iteration], log_prob=self.log_prob[: self.iteration],
            accepted=self.accepted, keys=keys, position=position,
            gauss=np.array([has_gauss, gauss]),
        )  # fmt: skip
        self._saved = time.monotonic()

    def _load(self) -> None:
        there = read_chain(self.path)
        if there.fingerprint != self.fingerprint:
            raise FileError(
                self.path, "holds the chain of another frame, or of other settings or seed",
                valid="the same command as before, or another file",
            )  # fmt: skip
        self.reset(*there.chain.shape[1:])
        self.chain, self.log_prob = there.chain, there.log_prob
        self.accepted, self.iteration = there.accepted, len(there.chain)
        has_gauss, gauss = there.gauss
        self.random_state = "MT19937", there.keys, there.position, int(has_gauss), float(gauss)
