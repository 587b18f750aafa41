"""The ablation's rows: the variants are settings, and leaving things out costs something."""

import pytest

from egocap.data.sequence import open_sequence
from egocap.pose.config import TrackerConfig
from egocap_eval.studies import ablation


def test_every_variant_is_a_setting():
    for name, settings in ablation.VARIANTS.items():
        config = TrackerConfig(**settings)
        assert (config == TrackerConfig()) == (
            name in (ablation.WHOLE, ablation.WITHOUT_DETECTIONS)
        )


def test_people_and_scenes_differ():
    scenes = ablation.make_scenes(3, 40, (64, 64))
    assert len({scene.seed for scene in scenes}) == len({scene.name for scene in scenes}) == 6
    assert all(scene.frames == 40 for scene in scenes)


def test_without_detections_the_track_is_worse(tiny_sequence):
    footage = {"tiny": open_sequence(tiny_sequence)}
    names = [ablation.WHOLE, ablation.WITHOUT_DETECTIONS]
    whole, blind = ablation.measure_variants(names, footage, "simulated:1.0", 2).values()
    assert blind["mpjpe_mm"][0] > whole["mpjpe_mm"][0] + 10
    row = ablation.summarise(ablation.WITHOUT_DETECTIONS, blind, whole)
    assert row["upper_mm"] == blind["upper_mm"][0]
    assert row["change_mm"] is None  # one sequence has no interval


def test_the_papers_energy_is_tracked_without_its_terms(tiny_sequence, monkeypatch):
    monkeypatch.setattr(ablation, "PAPER_FRAMES", 2)
    footage = open_sequence(tiny_sequence)
    whole, *parts = (
        ablation.tracked(name, footage, "simulated:1.0", 0) for name in ablation.PAPERS
    )
    assert len(whole.times) == 2
    assert ablation.measure_errors(footage, whole)["mpjpe_mm"] < 200
    for name, part in zip(list(ablation.PAPERS)[1:], parts, strict=True):
        assert not (part.angles == whole.angles).all(), name


def test_changes_are_paired_over_sequences():
    def measured(*errors):
        return {name: list(errors) for name in ablation.MEASURES}

    parts = {
        ablation.WHOLE: measured(10.0, 50.0),
        ablation.PAST: measured(12.0, 51.0),
        ablation.SINGLE: measured(15.0, 55.0),
        ablation.COLOUR: measured(9.0, 49.0),
        ablation.PAPER: measured(30.0, 60.0),
        f"{ablation.PAPER}, without colour": measured(34.0, 64.0),
    }
    found = ablation.statements(parts)
    # people differ by 40 mm, the change between them by nothing
    assert found["without_smoothness_mm"] == pytest.approx({"mean": 5.0, "half_interval": 0.0})
    assert found["without_colour_mm"] == pytest.approx({"mean": 1.0, "half_interval": 0.0})
    assert found["papers_without_colour_mm"] == pytest.approx({"mean": 4.0, "half_interval": 0.0})
    assert "papers_without_smoothness_mm" not in found
    assert found["without_smoothness_live_mm"]["mean"] == pytest.approx(3.5)
