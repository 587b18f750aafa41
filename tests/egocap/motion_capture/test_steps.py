"""A stage knows its input by content: the same name with another content is another input."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.data.sequence import Sequence
from egocap.errors import FileError, InputError
from egocap.files import write_json
from egocap.motion_capture import steps
from egocap.motion_capture.config import MocapOptions
from egocap.motion_capture.rig_search import load_search, write_search
from egocap.motion_capture.stages import Stages
from egocap.odometry.config import OdometryConfig
from egocap.odometry.self_calibration import Correction, RigSearch
from egocap.odometry.views import Views
from egocap.schema import read_json


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


@pytest.fixture
def found(tiny_sequence):
    """A search that corrects the rig of a sequence."""
    values, rig = np.arange(22.0).reshape(2, 11) * 1e-4, Sequence(tiny_sequence).rig
    correction = Correction.of(Views.of(rig, OdometryConfig().width), values, values + 1e-5)
    return RigSearch(correction, 1e-6 * np.arange(484.0).reshape(22, 22))


def test_a_correction_of_the_rig_is_sought_once_and_kept(
    tiny_sequence, tmp_path, monkeypatch, found
):
    """With the lags and readout times that a rig file has no place for."""
    sequence, asked = Sequence(tiny_sequence), []

    def search(sequence, views):
        asked.append(views)
        return found

    monkeypatch.setattr(steps, "search_rig", search)
    for _ in range(2):
        stages = Stages(tmp_path)
        rig, kept = steps.rig(stages, sequence, MocapOptions(), lambda *_: print)
        for name in ("values", "std"):
            np.testing.assert_array_equal(
                getattr(kept.correction, name), getattr(found.correction, name)
            )
        np.testing.assert_array_equal(kept.covariance, found.covariance)
        assert kept.correction.views.lag_s == found.correction.views.lag_s
        assert kept.correction.views.readout_s == found.correction.views.readout_s
        np.testing.assert_allclose(
            rig.T_head_camera, found.correction.rig(sequence.rig).T_head_camera, atol=1e-9
        )
        assert np.abs(rig.T_head_camera - sequence.rig.T_head_camera).max() > 1e-5
    assert len(asked) == 1

    def follow(sequence, rig, settings, advance, search):
        asked.append((settings.self_calibration, search))
        raise InputError("dark")

    monkeypatch.setattr(steps, "find_head_poses", follow)
    path = steps.head_poses(stages, sequence, kept, MocapOptions(), lambda *_: print)
    assert path is None and asked[1:] == [(False, kept)]


@pytest.mark.parametrize("damage", [
    lambda data: data | {"values": data["values"][:1]}, lambda data: data | {"std": []},
    lambda data: data | {"covariance": data["covariance"][:-1]}, lambda data: {"values": 3},
    lambda data: data | {"std": [["x"] * 11] * 2}, lambda data: data | {"more": 1},
])  # fmt: skip
def test_a_damaged_search_is_refused(tiny_sequence, tmp_path, found, damage):
    path, rig = tmp_path / "rig-correction.json", Sequence(tiny_sequence).rig
    write_search(path, found)
    write_json(path, damage(read_json(path)))
    with pytest.raises(FileError, match="rig-correction"):
        load_search(path, rig)


def test_a_search_without_correction_or_none_at_all(tiny_sequence, tmp_path, found):
    path, rig = tmp_path / "rig-correction.json", Sequence(tiny_sequence).rig
    write_search(path, replace(found, correction=None))
    kept = load_search(path, rig)
    assert kept.correction is None
    np.testing.assert_array_equal(kept.covariance, found.covariance)
    write_search(path, None)
    assert load_search(path, rig) is None
