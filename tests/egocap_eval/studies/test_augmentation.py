"""The augmentation study: its rows differ in what they say, and what it misses it says."""

from dataclasses import asdict

import pytest

from egocap.data.sequence import Sequence
from egocap.detect.train.config import NO_AUGMENTATION
from egocap.errors import InputError
from egocap_eval.studies.augmentation import ROWS, missed, study
from egocap_eval.studies.small_detectors import COLUMNS, Trainings, table


def rows(*pck):
    each = {c: {"mean": 50.0, "error": 1.0} for c in COLUMNS}
    return {n: each | {"pck": {"mean": p, "error": 0.5}} for n, p in zip(ROWS, pck, strict=True)}


def test_each_row_adds_one_thing():
    plain, background, recolour = (asdict(c) for c in ROWS.values())
    assert plain == asdict(NO_AUGMENTATION) | {"scale": 0.15, "gamma": 2.0}
    assert [k for k in plain if plain[k] != background[k]] == ["background"]
    assert [k for k in plain if background[k] != recolour[k]] == ["recolour"]


def test_misses_are_said():
    assert missed(rows(50.0, 70.0, 72.0)) == []
    assert len(missed(rows(50.0, 52.0, 51.0))) == 2


def test_table_has_errors():
    text = table(rows(50.0, 70.0, 72.0)).text()
    assert "+ background" in text and "70.0 (0.5)" in text


def test_runs_end_to_end(tiny_sequence, tmp_path):
    if Sequence(tiny_sequence).mask(0, "left") is None:
        with pytest.raises(InputError, match="part labels"):
            run(tiny_sequence, tmp_path)
        return
    found = run(tiny_sequence, tmp_path)
    assert set(found.result["rows"]) == set(ROWS)


def run(sequence, folder):
    one = (sequence,)
    return study(Trainings(one, one, one, 1, batch=2, seeds=1, network="tiny", views=4,
                           store=folder))  # fmt: skip
