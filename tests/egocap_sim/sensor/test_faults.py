"""Drops, exposure_drift and calibration errors of stated sizes."""

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.data.truth import BLACK
from egocap_sim.core.resources import builtin_file
from egocap_sim.sensor.config import PRESETS, SensorTable
from egocap_sim.sensor.faults import draw_sources, exposure_drift, miscalibrate


def test_frames_are_dropped_at_the_rate_and_repeat_the_last_good_one():
    source = draw_sources(20_000, 0.1, "repeat", np.random.default_rng(0))
    own = np.arange(len(source))
    dropped = source != own
    assert not dropped[0]
    assert dropped.mean() == pytest.approx(0.1, abs=0.01)
    assert (source[dropped] < own[dropped]).all()
    assert not dropped[source].any()  # what stands in was not dropped itself
    black = draw_sources(20_000, 0.1, "black", np.random.default_rng(0))
    assert np.array_equal(black == BLACK, dropped)


def test_fewer_frames_are_dropped_as_the_start_of_more():
    short, long = (draw_sources(n, 0.3, "repeat", np.random.default_rng(5)) for n in (40, 400))
    assert np.array_equal(long[:40], short)


def test_the_wander_has_its_deviation_and_is_slow():
    times = np.arange(0, 3000, 0.1)
    curves = np.stack([exposure_drift(times, 0.3, np.random.default_rng(i)) for i in range(20)])
    assert curves.std() == pytest.approx(0.3, rel=0.05)
    assert abs(curves.mean()) < 0.01
    assert np.abs(np.diff(curves)).max() < 0.3


def test_a_calibration_is_off_by_exactly_what_is_stated():
    rig = load_rig(builtin_file("rig", "egorig1"))
    sensor = SensorTable(calibration_rotation_deg=0.7, calibration_translation_m=0.004,
                         calibration_focal=0.01, calibration_centre_px=2.5)  # fmt: skip
    off = miscalibrate(rig, sensor, np.random.default_rng(3))
    for true, found in zip(rig.mounts, off.mounts, strict=True):
        turn = true.T_head_camera[:3, :3].T @ found.T_head_camera[:3, :3]
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) == pytest.approx(0.7)
        moved = found.T_head_camera[:3, 3] - true.T_head_camera[:3, 3]
        assert np.linalg.norm(moved) == pytest.approx(0.004)
        scale = found.camera.affine[0][0] / true.camera.affine[0][0]
        assert abs(scale - 1) == pytest.approx(0.01)
        shift = np.subtract(found.camera.centre, true.camera.centre)
        assert np.linalg.norm(shift) == pytest.approx(2.5)
    assert miscalibrate(rig, SensorTable(), np.random.default_rng(3)) == rig


def test_presets_and_what_they_switch_on():
    assert not SensorTable().active and not SensorTable(preset="clean").active
    for name in PRESETS.keys() - {"clean"}:
        table = SensorTable(preset=name)
        assert table.active and table.timed and table.miscalibrated
        assert SensorTable(**table.model_dump(exclude_none=True)) == table
    mixed = SensorTable(preset="webcam", jpeg_quality=33)
    assert (mixed.jpeg_quality, mixed.gamma) == (33, PRESETS["webcam"]["gamma"])
