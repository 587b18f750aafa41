"""The network in 8-bit integers, two to three times as fast as floats on CPUs with VNNI.

Weights are rounded by channel, to 7 bits: sums of products then do not saturate on CPUs without
VNNI, and all CPUs give the same result. Activations are rounded in the range that they have on
given views. The last layer of the heat maps and what follows stay in floating point.

Source: Jacob et al. 2018, "Quantization and training of neural networks for efficient
integer-arithmetic-only inference".
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap.detect.engine import INPUT, eight_bit_cache, export_onnx
from egocap.detect.train.examples import ViewStore
from egocap.detect.weights import Weights
from egocap.errors import require
from egocap.files import make_folder, write_atomically

VIEWS = 256  # from which the ranges are taken
_OPERATORS = ("Conv", "Add", "Relu", "Resize")
_BATCH = 2


def eight_bit_graph(weights: Weights, views: UInt8[Array, "N H W 3"]) -> bytes:
    """The network as ONNX in 8 bits, with ranges of activations from canonical views.

    Raises MachineError without onnx, onnxruntime or torch.
    """
    require("onnx", "train")
    import onnx
    from onnxruntime import quantization
    from onnxruntime.quantization.shape_inference import quant_pre_process

    class Reader(quantization.CalibrationDataReader):
        def __init__(self) -> None:
            self._batches = _batches(views)

        def get_next(self) -> dict[str, Array] | None:
            return next(self._batches, None)

    export_onnx(weights, exported := BytesIO())
    with TemporaryDirectory() as folder:
        whole, ready, rounded = (Path(folder) / f"{name}.onnx" for name in "abc")
        whole.write_bytes(exported.getvalue())
        quant_pre_process(whole, ready, skip_symbolic_shape=True)
        last = [node.name for node in onnx.load(ready).graph.node if "/heat/" in node.name]
        quantization.quantize_static(
            ready, rounded, Reader(), quant_format=quantization.QuantFormat.QDQ,
            op_types_to_quantize=list(_OPERATORS), per_channel=True, reduce_range=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8, nodes_to_exclude=last,
        )  # fmt: skip
        return rounded.read_bytes()


def keep_eight_bit(weights: Weights, graph: bytes) -> None:
    """Write a graph of `eight_bit_graph` where engines of these weights find it."""
    path = eight_bit_cache(weights)
    make_folder(path.parent)
    write_atomically(path, graph)


def some_views(store: ViewStore) -> UInt8[Array, "N H W 3"]:
    """At most `VIEWS` views, evenly from a whole store."""
    sizes = [len(views) for views in store.sequences]
    chosen = np.unique(np.linspace(0, sum(sizes) - 1, min(VIEWS, sum(sizes))).astype(int))
    first = np.concatenate([[0], np.cumsum(sizes)])
    at = np.searchsorted(first, chosen, side="right") - 1
    return np.stack(
        [store.sequences[s].images[i - first[s]] for s, i in zip(at, chosen, strict=True)]
    )


def _batches(views: UInt8[Array, "N H W 3"]) -> Iterator[dict[str, Any]]:
    for start in range(0, len(views), _BATCH):
        yield {INPUT: np.ascontiguousarray(views[start : start + _BATCH])}
