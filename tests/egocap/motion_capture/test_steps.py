"""A stage knows its input by content: the same name with another content is another input."""

from types import SimpleNamespace

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.data.sequence import Sequence
from egocap.errors import InputError
from egocap.motion_capture import steps
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.stages import Stages
from egocap.odometry.self_calibration import Correction


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


def test_a_correction_of_the_rig_is_sought_once_and_kept(tiny_sequence, tmp_path, monkeypatch):
    """With the lags and readout times that a rig file has no place for."""
    sequence, asked = Sequence(tiny_sequence), []
    values = np.arange(22.0).reshape(2, 11) * 1e-4

    def find(sequence, views):
        asked.append(views)
        return Correction.of(views, values, values + 1e-5)

    monkeypatch.setattr(steps, "find_rig_correction", find)
    for _ in range(2):
        rig, correction = steps.rig(Stages(tmp_path), sequence, MocapOptions(), lambda *_: print)
        np.testing.assert_array_equal(correction.values, values)
        np.testing.assert_array_equal(correction.std, values + 1e-5)
        assert correction.views.lag_s == tuple(values[:, 9])
        assert correction.views.readout_s == tuple(values[:, 10])
        np.testing.assert_allclose(
            rig.T_head_camera, correction.rig(sequence.rig).T_head_camera, atol=1e-9
        )
        assert np.abs(rig.T_head_camera - sequence.rig.T_head_camera).max() > 1e-5
    assert len(asked) == 1

    def follow(sequence, rig, settings, advance, correction):
        asked.append((settings.self_calibration, correction))
        raise InputError("dark")

    monkeypatch.setattr(steps, "find_head_poses", follow)
    found = steps.head_poses(Stages(tmp_path), sequence, correction, MocapOptions(),
                             lambda *_: print)  # fmt: skip
    assert found is None and asked[1:] == [(False, correction)]
