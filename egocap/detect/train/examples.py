"""Training examples: canonical views of annotated sequences, stored on disk.

Every sequence becomes a folder of arrays in a store: images, part labels if recorded, and the 18
labels of each view. Training reads random views from memory maps. Damaged shards are skipped with a
warning and counted.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
from collections.abc import Sequence as Several
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.commandline import progress
from egocap.data.arrays import record_of
from egocap.data.sequence import Sequence, open_sequence
from egocap.data.truth import OUT_OF_VIEW, VISIBLE
from egocap.detect.canonical_view import CanonicalView, ViewSpec
from egocap.errors import EgocapError, FileError
from egocap.files import make_folder, map_npy, read_npz, usable

log = logging.getLogger(__name__)

SEEN, HIDDEN, OUTSIDE, UNKNOWN = range(4)
"""States of a label in a canonical view: visible, in view but occluded, outside the view, and not
labelled, which training and scores leave out."""

_FORMAT = 2  # of the store


@dataclass(frozen=True, eq=False)
class Example:
    """One canonical view and its labels."""

    image: UInt8[Array, "H W 3"]
    points: Float[Array, "18 2"]  # pixels
    state: UInt8[Array, "18"]  # SEEN, HIDDEN, OUTSIDE, UNKNOWN
    parts: UInt8[Array, "H W"] | None = None


@dataclass(frozen=True, eq=False)
class Views:
    """Canonical views of one sequence and their labels, in the network's (mirrored) order."""

    images: UInt8[Array, "N H W 3"]
    parts: UInt8[Array, "N H W"] | None  # `egocap_sim.core.part_labels`; None: not recorded
    points: Float[Array, "N 18 2"]  # canonical pixels; meaningless where OUTSIDE or UNKNOWN
    state: UInt8[Array, "N 18"]  # SEEN, HIDDEN, OUTSIDE, UNKNOWN
    magnification: Float[Array, "N 18"]  # pixels at image width 640 per canonical pixel
    skipped: int = 0  # views whose shard was damaged

    def __len__(self) -> int:
        return len(self.images)


@dataclass(frozen=True, eq=False)
class ViewStore:
    """Views of several sequences as one list."""

    sequences: tuple[Views, ...]
    skipped: int = 0  # views that could not be read
    odds: tuple[float, ...] | None = None  # sampling weight of a view of each sequence; None: equal

    def __post_init__(self) -> None:
        counts = np.array([len(views) for views in self.sequences])
        odds = np.ones(len(counts)) if self.odds is None else np.array(self.odds)
        object.__setattr__(self, "_ends", np.cumsum(counts))
        object.__setattr__(self, "_mass", np.cumsum(counts * odds))

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self.sequences) else 0  # type: ignore[attr-defined]

    def locate(self, index: int) -> tuple[Views, int]:
        """Views of the sequence that contains view `index`, and its row there."""
        which = int(np.searchsorted(self._ends, index, side="right"))  # type: ignore[attr-defined]
        views = self.sequences[which]
        return views, index - (int(self._ends[which]) - len(views))  # type: ignore[attr-defined]

    def draw(self, rng: np.random.Generator) -> tuple[Views, int]:
        """Draw a view: the views of its sequence, and its row there."""
        mass: Array = self._mass  # type: ignore[attr-defined]
        which = int(np.searchsorted(mass, rng.random() * mass[-1], side="right"))
        views = self.sequences[min(which, len(mass) - 1)]
        return views, int(rng.integers(len(views)))


def mixed(stores: Several[ViewStore], shares: Several[float]) -> ViewStore:
    """Join stores, with sampling weights in the ratio of `shares`."""
    odds = (
        (share / len(store),) * len(store.sequences)
        for share, store in zip(shares, stores, strict=True)
    )
    return ViewStore(
        tuple(chain.from_iterable(store.sequences for store in stores)),
        sum(store.skipped for store in stores),
        tuple(chain.from_iterable(odds)),
    )


def build_store(folders: Several[Path], spec: ViewSpec, store: Path) -> ViewStore:
    """Views of all sequences, read from the store or added to it.

    Unreadable sequences and shards are skipped with a warning. Raises FileError if none is left.
    """
    make_folder(store)
    kept, skipped = [], 0
    with progress("reading sequences", len(folders), unit="sequences") as advance:
        for folder in folders:
            try:
                views = sequence_views(folder, spec, store)
                kept.append(views)
                skipped += views.skipped
            except EgocapError as error:
                log.warning("skipped: %s", error)
                skipped += 1
            advance()
    if skipped:
        log.warning("%d damaged views or sequences were skipped", skipped)
    kept = [views for views in kept if len(views)]
    if not kept:
        raise FileError(folders[0], "none of the sequences can be read")
    return ViewStore(tuple(kept), skipped)


def sequence_views(folder: Path, spec: ViewSpec, store: Path) -> Views:
    """Views of one sequence, read from the store or added to it. Raises FileError."""
    sequence = open_sequence(folder)
    place = store / _key(sequence, spec)
    if place.exists():
        try:
            return _read(place, spec)
        except FileError as error:
            log.warning("made again, as it is damaged: %s", error)
            if place.is_symlink() or place.is_file():
                place.unlink()
            else:
                shutil.rmtree(place)
    if not place.exists():
        part = place.with_name(f"{place.name}.{os.getpid()}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        try:
            _write(sequence, spec, part)
            if not place.exists():
                part.rename(place)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    return _read(place, spec)


def _key(sequence: Sequence, spec: ViewSpec) -> str:
    manifest = sequence.manifest
    what = [_FORMAT, spec.to_dict(), manifest.config_sha256, [s.sha256 for s in manifest.shards]]
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:24]


def _write(sequence: Sequence, spec: ViewSpec, place: Path) -> None:
    canonical = [CanonicalView(mount, spec) for mount in sequence.rig.mounts]
    with_parts = f"{sequence.rig.views[0]}.mask.png" in sequence.files(0)
    images, parts, labels, skipped = [], [], [], 0
    for shard in sequence.manifest.shards:
        try:
            found = [
                _view(sequence, shard.first + row, v, view, with_parts)
                for row in range(len(shard.frames))
                for v, view in enumerate(canonical)
                if not _dropped(sequence, shard.first + row, v)
            ]
        except EgocapError as error:
            log.warning("shard %s of %s is skipped: %s", shard.name, sequence.folder, error)
            skipped += len(shard.frames) * len(canonical)
            continue
        images += [f[0] for f in found]
        parts += [f[1] for f in found]
        labels += [f[2] for f in found]
    size = (0, spec.height, spec.width)
    np.save(place / "images.npy", np.stack(images) if images else np.zeros((*size, 3), np.uint8))
    if with_parts:
        np.save(place / "parts.npy", np.stack(parts) if parts else np.zeros(size, np.uint8))
    columns = [np.array(c) for c in zip(*labels, strict=True)] or [
        np.zeros((0, 18, 2)), np.zeros((0, 18), np.uint8), np.zeros((0, 18))
    ]  # fmt: skip
    np.savez(
        place / "labels.npz",
        points=columns[0].astype(np.float32),
        state=columns[1].astype(np.uint8),
        magnification=columns[2].astype(np.float32),
        skipped=skipped,
    )


def _dropped(sequence: Sequence, index: int, view: int) -> bool:
    """Whether the frame was dropped, so that image and annotation differ in time."""
    return sequence.sensor is not None and bool(sequence.sensor.dropped[index, view])


def _view(
    sequence: Sequence, index: int, v: int, view: CanonicalView, with_parts: bool
) -> tuple[Array, Array | None, tuple[Array, Array, Array]]:
    name = sequence.rig.views[v]
    picture = sequence.picture(index, v)
    if picture is None:
        raise FileError(sequence.folder, f"frame {index} has no picture of '{name}'")
    image = view.image(picture)
    parts = None
    if with_parts:
        mask = sequence.mask(index, name)
        if mask is None:
            raise FileError(sequence.folder, f"frame {index} of '{name}' has no part labels")
        parts = view.image(mask, nearest=True)
    return image, parts, _labels(sequence, index, v, view)


def _labels(
    sequence: Sequence, index: int, v: int, view: CanonicalView
) -> tuple[Array, Array, Array]:
    """Points, states and magnification of the 18 labels in the network's order."""
    pixels, seen = (of_views[v] for of_views in sequence.labels(index))
    state = np.where(seen == VISIBLE, SEEN, np.where(seen == OUT_OF_VIEW, OUTSIDE, HIDDEN))
    return canonical_labels(pixels, state, view, sequence.rig.cameras[v].width)


def canonical_labels(
    pixels: Float[Array, "18 2"], state: Array, view: CanonicalView, width: int
) -> tuple[Array, Array, Array]:
    """Canonical points, states and magnification in the network's order, of one image's labels.

    Args:
        pixels: in the image.
        state: SEEN, HIDDEN, OUTSIDE or UNKNOWN.
        view: of the camera.
        width: of the image.
    """
    points, inside = view.to_view(pixels)
    state = np.where(inside | (state > HIDDEN), state, OUTSIDE)
    placed = state <= HIDDEN
    points = np.where(placed[:, None], points, 0.0)
    scale = np.where(placed, view.magnification(points), 1.0) * (640.0 / width)
    return tuple(view.labels(a, 0) for a in (points, state, scale))  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class _Labels:
    """What a sequence's folder of the store holds beside pixels, as in `Views`."""

    points: Float[Array, "N 18 2"]
    state: UInt8[Array, "N 18"]
    magnification: Float[Array, "N 18"]
    skipped: int


def _read(place: Path, spec: ViewSpec) -> Views:
    """The views in a folder of the store. Raises FileError unless all arrays fit each other."""
    file = place / "labels.npz"
    labels = record_of(file, _Labels, read_npz(file))
    numbers = usable(labels.points).all() and usable(labels.magnification).all()
    if not numbers or (labels.state > UNKNOWN).any() or labels.skipped < 0:
        raise FileError(file, "not the labels of views")
    size = (len(labels.state), spec.height, spec.width)
    parts = place / "parts.npy"
    return Views(
        map_npy(place / "images.npy", (*size, 3), np.uint8),
        map_npy(parts, size, np.uint8) if parts.exists() else None,
        **vars(labels),
    )
