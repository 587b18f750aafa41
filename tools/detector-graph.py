"""Write the ONNX graph of the shipped detector without its weights.

    python tools/detector-graph.py egocap/detect/shipped/default.onnx

Needed when the network of the shipped weights changes, not for other weights of the same network:
`sha256sum *.onnx *.safetensors > SHA256SUMS` in that folder first, for the weights, and after.
Requires the extra `train`.
"""

from __future__ import annotations

import sys
from io import BytesIO
from pathlib import Path

import onnx

from egocap.detect.engine import export_onnx
from egocap.detect.weights import open_weights
from egocap.files import write_atomically


def shipped_graph() -> bytes:
    """The exported graph without its initializers, which have the names of the tensors."""
    exported = BytesIO()
    export_onnx(open_weights(), exported, folded=False)
    model = onnx.load_from_string(exported.getvalue())
    stored = {name for name, value in open_weights().stored().items() if value.dtype.kind == "f"}
    assert {tensor.name for tensor in model.graph.initializer} == stored
    del model.graph.initializer[:]
    return model.SerializeToString(deterministic=True)


if __name__ == "__main__":
    write_atomically(Path(sys.argv[1]), shipped_graph())
