"""Write the ONNX graph of the shipped detector without its weights.

    python tools/detector-graph.py egocap/detect/shipped/default.onnx

Needed when the network of the shipped weights changes, not for other weights of the same network;
then `sha256sum *.onnx *.safetensors > SHA256SUMS` in that folder. Requires the extra `train`.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path

import onnx

from egocap.detect.engine import export_onnx
from egocap.detect.weights import Weights, open_weights
from egocap.files import write_atomically


def bare_graph(weights: Weights) -> bytes:
    """The exported graph without its initializers, which have the names of the tensors."""
    exported = BytesIO()
    export_onnx(weights, exported, folded=False)
    model = onnx.load_from_string(exported.getvalue())
    stored = {name for name, value in weights.stored().items() if value.dtype.kind == "f"}
    assert {tensor.name for tensor in model.graph.initializer} == stored
    del model.graph.initializer[:]
    return model.SerializeToString(deterministic=True)


if __name__ == "__main__":
    graph = Path(sys.argv[1])
    write_atomically(graph, bare_graph(open_weights(graph.with_suffix(".safetensors"))))
