"""The shipped graph with a file's weights is the network that torch runs."""

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from egocap.detect.engine import open_engine
from egocap.detect.onnx_graph import filled_graph, has_graph
from egocap.detect.weights import open_weights
from egocap.errors import FileError


@pytest.fixture(scope="module")
def shipped():
    return open_weights()


def changed(weights, path, change):
    """The weights file with its tensors changed by a function."""
    from safetensors import safe_open

    with safe_open(weights.path, "numpy") as file:
        metadata = file.metadata()
    tensors = load_file(weights.path)
    change(tensors)
    save_file(tensors, path, metadata)
    return open_weights(path)


def images(weights, count=2):
    shape = (count, weights.view.height, weights.view.width, 3)
    return np.random.default_rng(5).integers(0, 256, shape, dtype=np.uint8)


def test_equals_torch(shipped):
    pytest.importorskip("torch")
    found = open_engine(shipped, "onnxruntime", threads=1).run(images(shipped))
    expected = open_engine(shipped, "torch", threads=1).run(images(shipped))
    for a, b in zip(found, expected, strict=True):
        assert np.abs(a - b).max() < 1e-5 * np.abs(b).max()


def test_onnx_checks_it(shipped):
    onnx = pytest.importorskip("onnx")
    model = onnx.load_from_string(filled_graph(shipped))
    onnx.checker.check_model(model, full_check=True)
    tensors = load_file(shipped.path)
    for tensor in model.graph.initializer:
        expected = tensors[tensor.name].astype(np.float32)
        np.testing.assert_array_equal(onnx.numpy_helper.to_array(tensor), expected)


def test_other_weights_of_the_network_fill_it_too(shipped, tmp_path):
    def shift(tensors):
        tensors["heat.bias"] = tensors["heat.bias"] + np.float32(2.0)

    other = changed(shipped, tmp_path / "w.safetensors", shift)
    assert has_graph(other)
    before, after = (
        open_engine(w, "onnxruntime", threads=1).run(images(shipped, 1)) for w in (shipped, other)
    )
    np.testing.assert_allclose(after[0], before[0] + 2.0, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.pop("heat.weight"), "tensor missing.*18, 64, 1, 1"),
        (lambda t: t.update({"heat.bias": np.zeros(5, np.float32)}), r"has \[5\].*\[18\]"),
        (lambda t: t.update({"heat.bias": np.full(18, np.nan, np.float32)}), "not finite"),
        (lambda t: t.update({"more": np.zeros(1, np.float32)}), "unknown tensor"),
    ],
)
def test_damaged_weights_are_refused(shipped, tmp_path, change, says):
    with pytest.raises(FileError, match=says):
        filled_graph(changed(shipped, tmp_path / "w.safetensors", change))
