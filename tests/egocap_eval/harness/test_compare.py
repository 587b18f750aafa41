"""What changed between two runs: paired by frame, and said with its noise."""

import json

import numpy as np
import pytest

from egocap_eval.cli import main
from egocap_eval.harness.compare import changed_numbers, changed_scores, paired_changes

TIMES = np.arange(600) / 30


def errors(shift=0.0, seed=0, hard=0):
    """Errors of 20 s of video, hard second by second; `hard` names another hard sequence."""
    level = np.repeat(np.random.default_rng(hard).exponential(30.0, 20), 30)
    return level + shift + np.random.default_rng(seed).normal(size=600)


def run(**named):
    return {**named, **{f"times/{name}": TIMES for name in named}}


def test_a_small_change_of_all_frames_is_beyond_noise_and_noise_is_not():
    a = run(**{"m/worse": errors(), "m/same": errors(), "m/better": errors()})
    b = run(**{"m/worse": errors(0.5, seed=1), "m/same": errors(0.0, seed=2),
               "m/better": errors(-0.5, seed=3)})  # fmt: skip
    found = {row["name"]: row for row in paired_changes(a, b, seed=0)}
    assert found["m/worse"]["verdict"] == "worse" and found["m/better"]["verdict"] == "better"
    assert found["m/same"]["verdict"] == "within noise"
    low, high = found["m/worse"]["interval_mm"]
    assert low < 0.5 < high and found["m/worse"]["change_mm"] == pytest.approx(0.5, abs=0.2)


def test_one_bad_second_is_no_proof():
    later = errors(seed=1)
    later[90:120] += 15
    (row,) = paired_changes(run(**{"m/s": errors()}), run(**{"m/s": later}), seed=0)
    assert row["change_mm"] > 0.5 and row["verdict"] == "within noise"


def test_what_cannot_be_paired_says_so():
    a = run(**{"m/gone": errors(), "m/short": errors()[:60], "m/moved": errors()})
    a["times/m/short"] = TIMES[:60]
    b = run(**{"m/new": errors(), "m/short": errors()[:60], "m/moved": errors()})
    b["times/m/short"], b["times/m/moved"] = TIMES[:60], TIMES + 0.5
    notes = {row["name"]: row["note"] for row in paired_changes(a, b, seed=0)}
    assert notes["m/gone"] == "only in A" and notes["m/new"] == "only in B"
    assert "shorter than" in notes["m/short"] and "cannot be paired" in notes["m/moved"]


def test_frames_missing_in_one_run_are_left_out_of_both():
    a, b = errors(), errors(1.0)
    a[:300] += 100
    b[:300] = np.nan
    (row,) = paired_changes(run(**{"m/s": a}), run(**{"m/s": b}), seed=0)
    assert row["change_mm"] == pytest.approx(1.0)


def test_measures_know_which_way_is_better():
    a = {"m": {"s": {"mpjpe_mm": 10.0, "spread/mpjpe_mm": 0.1, "pck3d_150": 90.0}}}
    b = {"m": {"s": {"mpjpe_mm": 11.0, "spread/mpjpe_mm": 0.1, "pck3d_150": 95.0}}}
    found = {row["measure"]: row for row in changed_scores(a, b)}
    assert found["mpjpe_mm"]["worse"] and found["mpjpe_mm"]["beyond_seeds"]
    assert found["pck3d_150"]["worse"] is False and found["pck3d_150"]["beyond_seeds"] is None


def test_results_are_compared_number_by_number(tmp_path, capsys):
    before = {"rows": [{"mpjpe_mm": 7.0, "name": "walk"}], "missed": [], "ok": True}
    after = {"rows": [{"mpjpe_mm": 7.7, "name": "run"}], "missed": [], "ok": False, "new": 3}
    found = {row["name"]: (row["a"], row["b"]) for row in changed_numbers(before, after)}
    assert found == {"rows.0.mpjpe_mm": (7.0, 7.7), "new": (None, 3)}
    (gone,) = changed_numbers({"clips": {"a": {"mm": 1.0}}}, {"clips": {}})
    assert (gone["name"], gone["a"], gone["b"]) == ("clips.a.mm", 1.0, None)
    longer = changed_numbers({"mm": [1.0]}, {"mm": [50.0, 2.0]})
    assert [(row["name"], row["b"]) for row in longer] == [("mm.0", 50.0), ("mm.1", 2.0)]
    for name, content in (("a", before), ("b", after)):
        text = json.dumps({"schema": 1, "command": "x", "result": content})
        (tmp_path / f"{name}.json").write_text(text)
    files = [str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert main(["compare", *files]) == 0
    assert "rows.0.mpjpe_mm" in capsys.readouterr().out
    assert main(["compare", files[0], str(tmp_path)]) == 2
    assert main(["compare", files[0], str(tmp_path / "c.json")]) == 2
