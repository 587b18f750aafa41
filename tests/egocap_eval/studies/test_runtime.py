"""The runtime study: every stage is timed, and what is missing says why."""

import re

import numpy as np
import pytest

from egocap.data.sequence import open_sequence
from egocap.errors import InputError
from egocap_eval.studies import runtime


@pytest.fixture
def footage(tiny_sequence):
    return open_sequence(tiny_sequence)


def test_solvers_are_timed(footage):
    pytest.importorskip("egocap.paper.tracker")
    timed = runtime.time_solvers(footage, 7, 2, 1)
    assert set(timed) >= {
        "fast",
        "fast, live",
        "reference",
        "stochastic",
        "stochastic, colours alone",
    }
    for name, solver in timed.items():
        assert solver["frames_per_second"] == pytest.approx(1 / solver["seconds_per_frame"])
        assert np.isfinite(solver["mpjpe_mm"]), name
    reference = timed["reference"]
    assert reference["iterations"] == 200 and reference["frames"] == 2
    assert reference["ms_per_iteration"] == pytest.approx(5 * reference["seconds_per_frame"])
    assert timed["reference"]["seconds_per_frame"] > timed["fast"]["seconds_per_frame"]


def test_the_whole_way_is_timed(footage):
    found = runtime.time_pipeline(footage, 7, 1, 1)
    if "missing" in found:
        pytest.skip(found["missing"])
    assert set(found["live"]["stages_ms"]) == {"decode", "detect", "track"}
    spent = {way: found[way]["stages_ms"].values() for way in ("batch", "live")}
    assert found["batch"]["frames_per_second"] == pytest.approx(1e3 / sum(spent["batch"]))
    assert found["live"]["frames_per_second"] <= 1.1e3 / max(spent["live"])
    assert found["live"]["latency_ms"]["p95"] >= found["live"]["latency_ms"]["median"] > 0


def test_engines_that_are_missing_say_why(footage, monkeypatch):
    monkeypatch.setattr(runtime, "ENGINES", ("cuda",))
    found = runtime.time_engines(footage, 7, 1, 1)["cuda"]
    assert re.search("CUDA|torch", found.get("missing", "CUDA"))


def test_too_little_is_refused():
    for name, study in (
        ("frames", lambda: runtime.study(frames=0)),
        ("few", lambda: runtime.study(few=0)),
        ("repeats", lambda: runtime.study(repeats=0)),
    ):
        with pytest.raises(InputError, match=f"0 {name}"):
            study()


def test_tables_say_what_is_missing():
    solver = {"frames_per_second": 250.0, "mpjpe_mm": 12.0}
    result = {
        "solvers": {"fast": solver, "reference": solver | {"ms_per_iteration": 5.0}},
        "detector": {"cuda": {"missing": "no GPU"}},
        "pipeline": {"missing": "no weights"},
    }
    text = "\n".join(table.text() for table in runtime.tables(result))
    assert "no GPU" in text and "5.00" in text and "0.1" in text
