"""Calibration of weights on annotated footage not used in training."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence as Several
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.commandline import progress
from egocap.data.dataset import find_sequences
from egocap.detect.calibration import Calibration, fit_calibration
from egocap.detect.engine import Engine, eight_bit_engine
from egocap.detect.heatmaps import decode
from egocap.detect.train.examples import OUTSIDE, SEEN, ViewStore, build_store
from egocap.detect.train.quantise import eight_bit_graph, keep_eight_bit, some_views
from egocap.detect.weights import Weights, open_weights, with_calibration

_BATCH = 8  # views at once


@dataclass(frozen=True, eq=False)
class AnnotatedOutputs:
    """Outputs of a network for N annotated views, with errors and true states."""

    info: Float[Array, "N 18 4"]
    errors: Float[Array, "N 18"]  # distance from the true point, canonical pixels
    state: UInt8[Array, "N 18"]  # `egocap.detect.train.examples`: SEEN, HIDDEN, OUTSIDE


def calibrate(
    weights: Weights, paths: Several[Path], store: Path, out: Path, threads: int | None = None
) -> Calibration:
    """Fit the calibration of `weights` on annotated sequences and write both to `out`.

    The network is calibrated in 8-bit integers, and kept so for this machine. `paths` are
    sequences or folders of them, `store` is a folder for their canonical views. The result is
    deterministic. Raises FileError or InputError without enough annotated views, MachineError
    without the packages that make the network in 8 bits.
    """
    folders = find_sequences(paths)
    views = build_store(folders, weights.view, store)
    graph = eight_bit_graph(weights, some_views(views))
    with TemporaryDirectory() as folder:
        (path := Path(folder) / "int8.onnx").write_bytes(graph)
        engine = eight_bit_engine(path, "onnxruntime-int8", threads)
        outputs = run_on_store(engine, weights.stride, views)
    seen, in_view = outputs.state == SEEN, outputs.state != OUTSIDE
    found = fit_calibration(outputs.info, outputs.errors, seen, in_view)
    account: dict[str, Any] = {
        "views": len(outputs.info), "sequences": len(folders),
        "joints_seen": int(seen.sum()), "joints_hidden": int((in_view & ~seen).sum()),
        "manifests_sha256": _checksum(folders),
    }  # fmt: skip
    with_calibration(weights, found, dict(weights.training) | {"calibration": account}, out)
    keep_eight_bit(open_weights(out), graph)
    return found


def run_on_store(engine: Engine, stride: int, store: ViewStore) -> AnnotatedOutputs:
    """Run a network on every view of a store."""
    columns: list[tuple[Array, ...]] = []
    with progress("calibrating", len(store), unit="views") as advance:
        for views in store.sequences:
            for start in range(0, len(views), _BATCH):
                rows = slice(start, start + _BATCH)
                heat, info = engine.run(np.ascontiguousarray(views.images[rows]))
                off = decode(heat, stride).points - views.points[rows]
                columns.append((info, np.linalg.norm(off, axis=-1), views.state[rows]))
                advance(len(info))
    return AnnotatedOutputs(*(np.concatenate(c) for c in zip(*columns, strict=True)))


def _checksum(folders: Several[Path]) -> str:
    manifests = sorted((folder / "manifest.json").read_bytes() for folder in folders)
    return hashlib.sha256(b"".join(manifests)).hexdigest()
