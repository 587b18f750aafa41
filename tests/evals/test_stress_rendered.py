"""Rendered sweeps: each level is one change of the same scene."""

import pytest

from egocap.errors import MachineError
from evals.cli import main
from evals.stress_rendered import SWEEPS, base_scene, study


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


def test_a_sweep_from_scene_to_table(tmp_path, monkeypatch):
    import evals.stress_rendered as module

    sweep = SWEEPS["jpeg"]
    ends = {q: sweep.levels[q] for q in (10, 95)}
    monkeypatch.setitem(module.SWEEPS, "jpeg", type(sweep)(sweep.unit, sweep.words, ends))
    try:
        outcome = study("jpeg", "simulated:1.0", tmp_path, people=2, frames=3, size=(160, 128),
                        workers=1)  # fmt: skip
    except MachineError as error:
        pytest.skip(f"no OpenGL: {error}")
    levels = outcome.result["sweeps"]["jpeg"]["levels"]
    assert [level["value"] for level in levels] == [10, 95]
    assert levels[0]["pck20"]["mean"] == 100 and len(levels[0]["draws"]) == 2
    assert levels[0]["mpjpe_mm"]["mean"] == levels[1]["mpjpe_mm"]["mean"]  # not seen by this source
    assert "quality" in outcome.to_text()


def test_one_person_has_no_error_bars(capsys):
    assert main(["stress-rendered", "--people", "1"]) == 2
    assert "2 or more" in capsys.readouterr().err
