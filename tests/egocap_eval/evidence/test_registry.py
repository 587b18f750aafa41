"""Every committed result can be made again by its command, and counts as stale when it must."""

import json

import pytest

from egocap.errors import InputError, MachineError
from egocap_eval.evidence import refresh
from egocap_eval.evidence.registry import Cited, chosen, entries
from egocap_eval.harness import study_sources
from egocap_eval.harness.result_file import save_result, shipped_weights
from egocap_eval.harness.sources import source_hashes
from egocap_eval.harness.study_sources import STUDY_SOURCES, sources_of
from egocap_eval.harness.thresholds import COMMITTED
from tests.test_docs import help_of

SPEED = entries()["detector_speed.json"]


def test_every_result_has_its_entry_and_its_sources():
    assert {path.name for path in COMMITTED.glob("*.json")} <= set(entries())
    for entry in entries().values():
        assert sources_of(entry.command), entry.file


def test_all_sources_exist():
    for study in STUDY_SOURCES:
        assert source_hashes(STUDY_SOURCES[study])


def test_commands_are_filled_in(tmp_path):
    entry = entries()["detector.json"]
    (words,) = entry.commands(tmp_path / "work", tmp_path / "clips")
    assert words[:4] == [
        "egocap-eval",
        "detector",
        "--validation",
        str(tmp_path / "work/validation"),
    ]
    assert words[-2:] == ["--out", "evals/results/detector.json"]
    assert "WORK/validation" in entry.shown() and "{" not in entry.shown()
    for entry in entries().values():
        for words in entry.commands(tmp_path, tmp_path):
            assert words[0] in ("egocap", "egocap-eval", "egocap-sim", "python"), words


def test_options_of_the_commands_exist(tmp_path):
    for entry in entries().values():
        for program, name, *words in entry.commands(tmp_path, tmp_path):
            if program == "python":
                continue
            told = help_of(program, name)
            for option in (w for w in words if w.startswith("--")):
                assert option in told, f"{entry.file}: {program} {name} has no {option}"


def test_the_test_set_is_only_measured_by_its_name():
    assert "recorded-test.json" not in [entry.file for entry in chosen(())]
    assert [entry.file for entry in chosen(["recorded-test"])] == ["recorded-test.json"]
    with pytest.raises(InputError, match="no result nothing"):
        chosen(["nothing"])


def saved(folder, **changes):
    save_result(folder / SPEED.file, {"engines": {}}, SPEED.command)
    path = folder / SPEED.file
    path.write_text(json.dumps(json.loads(path.read_text()) | {"commit": "a" * 40} | changes))
    return Cited(SPEED, folder).stale


def test_a_result_is_stale_for_a_reason(tmp_path, monkeypatch):
    assert Cited(SPEED, tmp_path).stale == ("not measured yet",)
    assert saved(tmp_path) == ()
    assert saved(tmp_path, commit="a" * 40 + "+changes") == ("not made from a commit",)
    assert saved(tmp_path, commit=None) == ("not made from a commit",)
    assert saved(tmp_path, sources=None) == ("made before sources were recorded",)
    assert saved(tmp_path, weights="0" * 64) == ("of other detector weights",)
    assert json.loads((tmp_path / SPEED.file).read_text())["weights"] != shipped_weights()
    hashes = source_hashes(sources_of(SPEED.command))
    (why,) = saved(tmp_path, sources=hashes | {"benchmarks/detector.py": "0"})
    assert why == "changed since: benchmarks/detector.py"
    more = {"benchmarks/detector.py": (*STUDY_SOURCES["benchmarks/detector.py"], "egocap/body")}
    saved(tmp_path)
    monkeypatch.setattr(study_sources, "STUDY_SOURCES", STUDY_SOURCES | more)
    assert Cited(SPEED, tmp_path).stale == ("changed since: egocap/body",)


def test_refresh_lists_what_is_stale_cheapest_first():
    outcome = refresh.study(("calibration", "runtime", "recorded-validation"), dry_run=True)
    minutes = [row["minutes"] for row in outcome.result["stale"]]
    assert minutes == sorted(minutes)
    assert len(outcome.missed) == len(minutes) and outcome.result["failed"] == {}


def test_refresh_measures_and_reports_what_fails(tmp_path, monkeypatch):
    made = []

    def make(entry, work, motions, commit):
        made.append(entry.file)
        if entry.file == "runtime.json":
            raise MachineError("'egocap-eval runtime' exited with 1")
        return {}

    monkeypatch.setattr(refresh, "make", make)
    monkeypatch.setattr(refresh, "git_commit", lambda: "a" * 40)
    monkeypatch.setattr(Cited, "stale", property(lambda self: ("changed",)))
    outcome = refresh.study(("stress", "runtime"), motions=tmp_path, work=tmp_path)
    assert made == ["runtime.json", "stress.json"]
    assert outcome.result["failed"] == {"runtime.json": "'egocap-eval runtime' exited with 1"}
    with pytest.raises(InputError, match="--motions"):
        refresh.study(("stress",))
    monkeypatch.setattr(refresh, "git_commit", lambda: "a" * 40 + "+changes")
    with pytest.raises(InputError, match="uncommitted"):
        refresh.study(("stress",), motions=tmp_path)


def test_a_worker_of_another_commit_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(refresh, "git_commit", lambda: "b" * 40)
    with pytest.raises(MachineError, match="a worker is at b"):
        refresh.make(SPEED, tmp_path, tmp_path, "a" * 40)


def test_results_are_made_on_a_cluster(cluster, tmp_path, monkeypatch):
    def make(entry, work, motions, commit):
        if entry.file == "stress.json":
            raise MachineError("a worker is at b")
        return {entry.file: commit.encode()}

    monkeypatch.setattr(refresh, "make", make)
    monkeypatch.setattr(refresh, "ROOT", tmp_path)
    monkeypatch.setattr(refresh, "git_commit", lambda: "a" * 40)
    (tmp_path / refresh.RESULTS).mkdir(parents=True)
    todo = [entries()["runtime.json"], entries()["stress.json"]]
    failed = refresh._on_cluster(cluster)(todo, tmp_path, tmp_path)
    assert failed == {"stress.json": "a worker is at b"}
    assert (tmp_path / refresh.RESULTS / "runtime.json").read_text() == "a" * 40
