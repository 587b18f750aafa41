"""ONNX files without torch: the shipped graph, filled with the tensors of a weights file.

`shipped/default.onnx` is the graph of the shipped network's configuration without its weights, made
by `tools/detector-graph.py`; its initializers have the names of the tensors. Two Protocol Buffers
messages one after the other parse as one whose repeated fields are joined, so the weights are
appended as a message of their own.

Source: onnx.proto (ModelProto, GraphProto, TensorProto); Protocol Buffers, "Encoding".
"""

from __future__ import annotations

import numpy as np
from numpy import ndarray as Array

from egocap.detect.weights import Weights, open_weights, shipped_file, verified_content

_GRAPH, _INITIALIZER = 7, 5  # field of ModelProto, and of GraphProto
_DIMS, _DATA_TYPE, _NAME, _RAW_DATA = 1, 2, 8, 9  # fields of TensorProto
_FLOAT = 1  # TensorProto.DataType


def has_graph(weights: Weights) -> bool:
    """Whether the shipped graph is that of these weights: of the view, it has the size alone."""
    shipped = open_weights()
    same = all(weights.config.get(k) == v for k, v in shipped.config.items() if k != "view")
    return same and weights.view.size == shipped.view.size


def filled_graph(weights: Weights) -> bytes:
    """A complete ONNX file of the weights, in single precision. Raises FileError for damaged ones.

    Requires `has_graph`.
    """
    template = verified_content(shipped_file().with_suffix(".onnx"))
    shapes = {name: value.shape for name, value in open_weights().stored().items()}
    tensors = weights.tensors(shapes)
    graph = b"".join(
        _field(_INITIALIZER, _tensor(name, value))
        for name, value in tensors.items()
        if value.dtype.kind == "f"  # batch normalisation also counts its batches
    )
    return template + _field(_GRAPH, graph)


def _tensor(name: str, value: Array) -> bytes:
    """A TensorProto of single precision."""
    dims = b"".join(_key(_DIMS, 0) + _varint(size) for size in value.shape)
    raw = np.ascontiguousarray(value, "<f4").tobytes()
    kind = _key(_DATA_TYPE, 0) + _varint(_FLOAT)
    return dims + kind + _field(_NAME, name.encode()) + _field(_RAW_DATA, raw)


def _field(number: int, content: bytes) -> bytes:
    """A length-delimited field."""
    return _key(number, 2) + _varint(len(content)) + content


def _key(number: int, wire_type: int) -> bytes:
    return _varint(number << 3 | wire_type)


def _varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; the eighth bit of all but the last byte is set."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)
