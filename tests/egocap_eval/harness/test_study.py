"""The frame around every study: options, output, record and exit code."""

import json
import sys
import types
from pathlib import Path
from typing import Annotated

import pytest
from tyro.conf import Positional, arg

from egocap.evaluation.table import Table
from egocap_eval.harness import commands
from egocap_eval.harness.result_file import config_hash
from egocap_eval.harness.study import Outcome


def study(
    folder: Positional[Annotated[Path, arg(metavar="SEQ")]], /, seeds: int = 3, most: float = 9.0
) -> Outcome:
    """Count.

    Args:
        folder: Where.
        seeds: How many.
        most: How many at most.
    """
    missed = [f"{seeds} seeds, not {most:g}"] if seeds > most else []
    table = Table("counts", ("what", "count"), (("seeds", str(seeds)),))
    return Outcome({"seeds": seeds, "folder": str(folder)}, [table], missed, {"weights": "abc"})


@pytest.fixture(autouse=True)
def counting(monkeypatch):
    module = types.ModuleType("egocap_eval.counting_study")
    module.study = study
    monkeypatch.setitem(sys.modules, "egocap_eval.counting_study", module)
    monkeypatch.setitem(commands.STUDIES, "count", ("counting_study", "Counts things."))


def test_help_names_the_study_and_its_options(capsys):
    assert commands.main(["--help"]) == 0
    assert "Counts things." in capsys.readouterr().out
    assert commands.main(["count", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("SEQ", "How many at most.", "--json", "--out FILE"))


def test_help_of_a_missing_module_does_not_hurt_the_others(monkeypatch, capsys):
    monkeypatch.setitem(commands.STUDIES, "broken", ("no_such_module", "Not there."))
    assert commands.main(["--help"]) == 0
    assert commands.main(["count", "here"]) == 0
    assert "seeds      3" in capsys.readouterr().out


def test_a_missed_target_is_3_and_said(capsys):
    assert commands.main(["count", "here", "--seeds", "12", "--json"]) == 3
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"seeds": 12, "folder": "here"}
    assert captured.err == "missed: 12 seeds, not 9\n"


def test_the_record_says_what_was_run(tmp_path, capsys):
    out = tmp_path / "new" / "count.json"
    assert commands.main(["count", "here", "--seeds", "4", "--out", str(out)]) == 0
    record = json.loads(out.read_text())
    assert record["command"] == f"egocap-eval count here --seeds 4 --out {out}"
    assert record["config"] == {
        "options": {"folder": "here", "seeds": 4, "most": 9.0},
        "weights": "abc",
    }
    assert record["config_sha256"] == config_hash(record["config"])
    assert record["result"] == {"seeds": 4, "folder": "here", "missed": []}
    assert record["seconds"].keys() == {"wall", "cpu"} and record["machine"]["cpu"]


@pytest.mark.parametrize("suffix", [".md", ".txt"])
def test_tables_to_a_file(tmp_path, suffix):
    out = tmp_path / f"count{suffix}"
    assert commands.main(["count", "here", "--out", str(out)]) == 0
    assert "counts" in out.read_text()


@pytest.mark.parametrize("words", [["--json", "--markdown"], ["--out", "x.pdf"]])
def test_bad_output_is_2(words, capsys):
    assert commands.main(["count", "here", *words]) == 2
    assert "valid:" in capsys.readouterr().err


def test_the_hash_is_of_the_content():
    assert config_hash({"a": 1, "b": (2, 3)}) == config_hash({"b": [2, 3], "a": 1})
    assert config_hash({"a": 1}) != config_hash({"a": 1.5})
