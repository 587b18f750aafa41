"""A stage knows its input by content: the same name with another content is another input."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.motion_capture import steps
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.stages import Stages


def test_another_body_in_the_same_file(tmp_path):
    body = tmp_path / "wearer.json"
    options = MocapOptions(body=str(body))
    for height in (1.6, 1.9):
        given = Proportions.from_lengths(height)
        given.save(body)
        found, _ = steps.body(Stages(tmp_path), None, None, options, None)
        np.testing.assert_allclose(found.offsets, given.offsets, atol=1e-9)


@pytest.mark.parametrize("same", [True, False])
def test_other_weights_in_the_same_file(tmp_path, monkeypatch, same):
    made = []
    sequence = SimpleNamespace(manifest=SimpleNamespace(config_sha256="x"))
    stages = SimpleNamespace(run=lambda name, settings, write, read: made.append(settings))
    hashes = iter(["one", "one" if same else "two"])
    monkeypatch.setattr(steps, "open_weights", lambda path: SimpleNamespace(sha256=next(hashes)))
    for _ in range(2):
        steps.detections(stages, sequence, MocapOptions(weights=tmp_path / "w"), None)
    assert (made[0] == made[1]) is same
