"""Rendered sweeps: each level is one change of the same scene."""

import pytest

from egocap_eval.cli import main
from egocap_eval.studies import stress_rendered
from egocap_eval.studies.stress_rendered import SWEEPS, base_scene


@pytest.mark.parametrize("name", SWEEPS)
def test_a_level_changes_one_table_of_the_scene(name):
    before = base_scene(0, 10, (640, 512))
    seen = set()
    for change in SWEEPS[name].levels.values():
        after = change(before)
        differing = [k for k, v in after.model_dump().items() if v != before.model_dump()[k]]
        assert len(differing) <= 1 and after.seed == before.seed
        seen |= set(differing)
    assert len(seen) == 1 and len(SWEEPS[name].levels) >= 5


def test_a_sequence_is_detected_tracked_and_scored(tiny_scene, tiny_sequence):
    numbers = stress_rendered.measure_scene(tiny_scene, tiny_sequence, "simulated:1.0", workers=1)
    assert list(numbers) == list(stress_rendered.MEASURES)
    assert numbers["pck20"] == 100 and 0 < numbers["mpjpe_mm"] < 200


def test_a_sweep_has_error_bars_over_people(monkeypatch):
    def scored(scene, folder, source, workers):
        quality = scene.sensor.jpeg_quality
        return dict.fromkeys(stress_rendered.MEASURES, quality + scene.seed % 10) | {
            "hidden_mm": None
        }

    monkeypatch.setattr(stress_rendered, "measure_scene", scored)
    outcome = stress_rendered.study("jpeg", people=2)
    levels = outcome.result["sweeps"]["jpeg"]["levels"]
    assert [level["value"] for level in levels] == [10, 25, 50, 75, 95]
    assert levels[0]["pck20"] == pytest.approx(
        {"mean": 11.5, "half_interval": 12.706 * 0.5}, rel=1e-3
    )
    assert levels[0]["hidden_mm"] is None and len(levels[0]["draws"]["pck20"]) == 2
    assert "quality" in outcome.to_text()


def test_one_person_has_no_error_bars(capsys):
    assert main(["stress-rendered", "--people", "1"]) == 2
    assert "2 or more" in capsys.readouterr().err
