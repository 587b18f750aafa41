"""The ablation's rows: the variants are settings, and leaving things out costs something."""

import numpy as np
import pytest

from egocap.sequence import open_sequence
from egocap.track.config import TrackerConfig
from evals import ablation


def test_every_variant_is_a_setting():
    for name, settings in ablation.VARIANTS.items():
        config = TrackerConfig(**settings)
        assert (config == TrackerConfig()) == (name in (ablation.WHOLE, ablation.BLIND))


def test_people_and_scenes_differ():
    scenes = ablation._scenes(3, 40, (64, 64))
    assert len({scene.seed for scene in scenes}) == len({scene.name for scene in scenes}) == 6
    assert all(scene.frames == 40 for scene in scenes)


def test_without_detections_the_track_is_worse(tiny_sequence):
    sequences = [open_sequence(tiny_sequence)]
    whole = ablation._measure(ablation.WHOLE, sequences, "simulated:1.0", 1)
    blind = ablation._measure(ablation.BLIND, sequences, "simulated:1.0", 1)
    row = ablation._row(ablation.BLIND, blind, whole[0]["mpjpe"])
    assert row.change_mm == pytest.approx(blind[0]["mpjpe"] - whole[0]["mpjpe"])
    assert row.change_mm > 10 and np.isfinite(row.mpjpe_mm)
