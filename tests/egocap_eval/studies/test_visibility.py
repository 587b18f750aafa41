"""The study of visibility against the field of view, on angles whose answer is known."""

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap_eval.studies.visibility import curves, draw, off_axis, study, tilted


def test_shares_and_the_field_of_view_for_95_percent():
    angle = np.deg2rad(np.linspace(0.5, 100.0, 200))[:, None] * np.ones(len(LABELS))
    hidden = np.zeros(angle.shape, bool)
    hidden[:8, 1] = True  # 4 % of the neck's frames
    hidden[:20, 2] = True
    result = curves(angle, hidden)
    head, neck, shoulder = (result["joints"][LABELS[j]] for j in range(3))
    at = result["fov_deg"].index
    assert head["in_view"][at(160)] == pytest.approx(0.8) == head["seen"][at(160)]
    assert head["fov_for_95_in_view"] == pytest.approx(190.0, abs=0.1)
    assert neck["seen"][at(160)] == pytest.approx(0.76)
    assert neck["fov_for_95_seen"] == pytest.approx(198.0, abs=0.1)
    assert shoulder["fov_for_95_seen"] is None and shoulder["hidden_by_wearer"] == 0.1


def test_a_camera_tilted_forward_turns_towards_what_lies_ahead():
    ahead = np.array([0.0, -1.0, 1.0])  # 45 degrees before the axis
    assert np.rad2deg(off_axis(ahead)) == pytest.approx(45.0)
    assert np.rad2deg(off_axis(ahead, 45.0)) == pytest.approx(0.0, abs=1e-6)
    assert np.rad2deg(off_axis(np.array([0.0, 0.0, 2.0]), 60.0)) == pytest.approx(60.0)
    found = tilted(np.broadcast_to(ahead, (10, len(LABELS), 3)))
    assert found["fov_for_95_in_view"]["head"][0] == pytest.approx(90.0, abs=0.1)


def test_draws_and_refuses(tmp_path):
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(30, len(LABELS), 3))
    result = curves(off_axis(joints), np.zeros((30, len(LABELS)), bool))
    draw(result, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="minutes"):
        study(minutes=0)
