"""Weights with another view: the tensors, the graph and the record."""

import numpy as np
import pytest

from egocap.detect.onnx_graph import has_graph
from egocap.detect.weights import open_weights, shipped_file
from egocap.errors import InputError
from egocap_eval.detection.magnify import magnify


def test_only_the_view_changes(tmp_path):
    old = open_weights()
    magnify(shipped_file(), 2.0 * old.view.focal, out := tmp_path / "large.safetensors")
    new = open_weights(out)
    assert new.view.boom_focal == 2.0 * new.view.focal
    assert new.view.mounted(0.1) == old.view.mounted(0.1)
    assert has_graph(new)
    tensors = new.stored()
    for name, value in old.stored().items():
        np.testing.assert_array_equal(tensors[name], value)
    assert "calibration" not in new.training
    assert new.training["trained_view"]["focal"] == old.view.focal
    with pytest.raises(InputError, match="focal"):
        magnify(shipped_file(), 0.0, out)
