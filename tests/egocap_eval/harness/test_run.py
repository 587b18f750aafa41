"""Suites: made once, scored twice, never mixed."""

import json
import re
import sys
import types

import numpy as np
import pytest

from egocap.data.sequence import open_sequence
from egocap.errors import FileError
from egocap.evaluation.predictions import Predictions, save_predictions
from egocap.evaluation.table import Table
from egocap_eval.harness import commands
from egocap_eval.harness.commands import main
from egocap_eval.harness.result_file import load_result, save_result
from egocap_eval.harness.study import Outcome
from egocap_eval.harness.suite import FOLDER, PaperRow, load_suite
from egocap_eval.harness.thresholds import COMMITTED, Numbers

SUITE = """
name = "small"
description = "Seven frames <b>& a</b> file."
protocols = ["egocap-17", "mo2cap2-15-pa"]
measures = ["mpjpe_mm", "pck3d_150"]
sequences = [
    {{ name = "walk", folder = "{folder}" }},
    {{ name = "clip", scene = "validation-walk", motion = "bvh/none.bvh" }},
]
[[methods]]
name = "noisy"
detections = "simulated:2.0"
seeds = 2
[[methods]]
name = "mine"
predictions = "{{sequence}}.npz"
[[methods]]
name = "theirs"
predictions = "theirs/{{sequence}}.npz"
optional = true
[[thresholds]]
method = "mine"
measure = "mpjpe_mm"
most = 31
[[rows]]
section = "5.4"
statement = "walking"
paper = "70"
ours = "mine/walk/mpjpe_mm"
[[rows]]
section = "5.5"
statement = "without smoothness"
paper = "30"
ours = "noisy/walk/mpjpe_mm"
less = "nothing.json:mpjpe_mm"
"""


@pytest.fixture(scope="module")
def place(tiny_sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    (folder / "small.toml").write_text(SUITE.format(folder=tiny_sequence))
    joints = open_sequence(tiny_sequence).truth.joints_head + [0.03, 0.0, 0.0]
    valid = np.ones(joints.shape[:2], bool)
    save_predictions(
        folder / "walk.npz", Predictions(joints, valid, "head", "m", np.arange(len(joints)))
    )
    words = ["run", str(folder / "small.toml"), "--work", str(folder / "out")]
    assert main(words) == 0
    return folder, words


def test_scores_are_of_the_saved_predictions(place):
    folder, _ = place
    result = load_result(folder / "out/scores.json")["result"]
    entry = result["scores"]["mine"]["walk"]
    assert entry["mpjpe_mm"] == pytest.approx(30)
    assert entry["protocol/mo2cap2-15-pa"] == pytest.approx(0, abs=1e-6)
    noisy = result["scores"]["noisy"]["walk"]
    assert len(noisy["seeds"]) == 2 and noisy["spread/mpjpe_mm"] > 0
    assert noisy["mpjpe_mm"] == pytest.approx(np.mean([s["mpjpe_mm"] for s in noisy["seeds"]]))
    assert result["left_out"] == ["clip", "theirs"] and result["missed"] == []
    with np.load(folder / "out/errors.npz") as errors:
        np.testing.assert_allclose(errors["mine/walk"], 30)
        assert len(errors["times/mine/walk"]) == 7


def test_the_paper_rows_have_numbers_or_reasons(place):
    rows = load_result(place[0] / "out/scores.json")["result"]["paper"]
    assert rows[0]["shown"] == "30.0" and rows[1]["ours"] is None
    assert "not measured yet" in rows[1]["note"]


def test_the_page_needs_nothing_beside_itself(place):
    page = (place[0] / "out/report.html").read_text()
    assert len(page) < 5e6
    addresses = re.findall(r"""(?:src|href)=["']?([^"'> ]*)""", page)
    assert addresses and all(a.startswith(("data:", "#")) for a in addresses)
    assert "@import" not in page and "fetch(" not in page
    assert "Seven frames &lt;b&gt;&amp; a&lt;/b&gt; file." in page
    assert "data:image/jpeg" in page and "noisy, walk" in page
    motions = json.loads(re.search(r"const motions = (\[.*?\]), bones", page, re.S)[1])
    assert [m["name"] for m in motions] == ["noisy, walk", "mine, walk"]
    assert motions[1]["errors"] == [30.0] * 7


def test_markdown_says_the_same(place):
    text = (place[0] / "out/report.md").read_text()
    assert "| mine | walk | 30.0 |" in text and "The paper's section 5" in text


def test_nothing_is_made_twice(place):
    folder, words = place
    files = {p: p.stat().st_mtime_ns for p in (folder / "out/predictions").rglob("*.npz")}
    assert len(files) == 2
    assert main(words) == 0
    assert files == {p: p.stat().st_mtime_ns for p in files}


def test_a_changed_configuration_is_not_mixed_in(place, tmp_path, capsys):
    folder, words = place
    text = (folder / "small.toml").read_text()
    changed = folder / "changed.toml"
    changed.write_text(text.replace("seeds = 2", "seeds = 2\nconfig = { zeta = 0.5 }"))
    assert main(["run", str(changed), *words[2:]]) == 2
    message = capsys.readouterr().err
    assert "another configuration" in message and "0.npz" in message and "config was" in message
    changed.write_text(text.replace('"small"', '"other"'))
    assert main(["run", str(changed), *words[2:]]) == 2
    assert "of the suite 'small'" in capsys.readouterr().err


def test_studies_run_once_and_leave_stdout_to_the_suite(place, monkeypatch, capsys):
    folder, words = place
    runs = []

    def study(limit: float = 1.0) -> Outcome:
        runs.append(limit)
        return Outcome({"value": 2.0}, [Table("counted", ("x",), (("2",),))], ["2 is over 1"])

    module = types.ModuleType("egocap_eval.counting_study")
    module.study = study
    monkeypatch.setitem(sys.modules, "egocap_eval.counting_study", module)
    monkeypatch.setitem(commands.STUDIES, "count", ("counting_study", "Counts."))
    counted = folder / "counted.toml"
    text = (folder / "small.toml").read_text().replace("nothing.json:mpjpe_mm", "count.json:value")
    counted.write_text(text + '[[studies]]\nname = "count"\noptions = ["--limit", "1.5"]\n')
    for _ in range(2):
        assert main(["run", str(counted), *words[2:], "--json", "--no-html"]) == 3
        captured = capsys.readouterr()
        rows = json.loads(captured.out)["paper"]
        assert rows[1]["ours"] is not None and "count: 2 is over 1" in captured.err
    assert runs == [1.5]
    counted.write_text(counted.read_text().replace("1.5", "1.6"))
    assert main(["run", str(counted), *words[2:]]) == 2
    assert "is of another command" in capsys.readouterr().err


def test_a_method_that_must_be_there(place, capsys):
    folder, words = place
    needed = folder / "needed.toml"
    needed.write_text((folder / "small.toml").read_text().replace("optional = true", ""))
    assert main(["run", str(needed), *words[2:]]) == 2
    assert "theirs/walk.npz: no such file of predictions" in capsys.readouterr().err


def test_a_missed_threshold_is_3(place, tmp_path, capsys):
    folder, words = place
    strict = folder / "strict.toml"
    strict.write_text((folder / "small.toml").read_text().replace("most = 31", "most = 29"))
    assert main(["run", str(strict), *words[2:], "--no-html"]) == 3
    assert "mine, walk: mpjpe_mm is 30, not at most 29" in capsys.readouterr().err


def test_two_runs_are_compared(place, capsys):
    folder, _ = place
    assert main(["compare", str(folder / "out"), str(folder / "out")]) == 0
    text = capsys.readouterr().out
    assert "mine/walk" in text and "+0.00" in text and "shorter than 4 s" in text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"pck3d_150"', '"pck"', "no measure 'pck'.*mpjpe_mm"),
        ('"mo2cap2-15-pa"', '"h36m"', "no protocol 'h36m'"),
        (
            'method = "mine"',
            'method = "yours"',
            "thresholds.0.*no method 'yours'.*noisy, mine, theirs",
        ),
        ('name = "mine"', 'name = "noisy"', "same name twice"),
        ("most = 31", "", "'most' or 'least'"),
        ("seeds = 2", "seed = 2", "unknown key.*seeds"),
        ("seeds = 2", "seeds = 0", "methods.0.seeds"),
        ('name = "walk", folder', 'name = "a/b", folder', "sequences.0.name"),
        ('detections = "simulated:2.0"', 'predictions = "x"\nconfig = { zeta = 1 }', "settings"),
    ],
)
def test_a_bad_suite_names_the_key(place, tmp_path, old, new, message):
    text = (place[0] / "small.toml").read_text()
    assert old in text
    (tmp_path / "bad.toml").write_text(text.replace(old, new))
    with pytest.raises(FileError, match=message):
        load_suite(tmp_path / "bad.toml")


def test_unknown_suites_and_settings(place, tmp_path, capsys):
    assert main(["run", "nothing"]) == 2
    assert "quick" in capsys.readouterr().err
    text = (place[0] / "small.toml").read_text()
    (tmp_path / "bad.toml").write_text(text.replace("seeds = 2", "config = { lambda = 1.0 }"))
    assert main(["run", str(tmp_path / "bad.toml"), "--work", str(tmp_path / "out")]) == 2
    assert "no setting 'lambda'" in capsys.readouterr().err
    (tmp_path / "bad.toml").write_text(text + '[[studies]]\nname = "everything"\n')
    assert main(["run", str(tmp_path / "bad.toml"), "--work", str(tmp_path / "out")]) == 2
    assert "no study 'everything'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda p: p.stem)
def test_built_in_suites_are_sound(path):
    if path.stem == "paper":
        pytest.skip("the rows of the others")
    suite = load_suite(path)
    assert suite.name == path.stem
    methods, sequences = ({e.name for e in es} for es in (suite.methods, suite.sequences))
    sections = {row.section for row in suite.rows}
    if path.stem == "recordings":
        assert not sections and methods and sequences and suite.thresholds
    else:
        assert {"5.1", "5.2", "5.3", "5.4", "5.5"} <= sections
    for row in suite.rows:
        for place in (row.ours, row.less):
            if place and ".json:" not in place:
                method, sequence, _ = place.split("/", 2)
                assert method in methods | {"learned"} and sequence in sequences, place
        assert row.command if row.ours else row.conditions, row.statement


def test_every_place_in_a_committed_result_is_there(tmp_path):
    numbers = Numbers({}, tmp_path)
    for row in load_suite(FOLDER / "quick.toml").rows:
        for place in (row.ours, row.less, row.error):
            if place and (COMMITTED / place.partition(":")[0]).is_file():
                assert numbers.find(place)[0] is not None, place


def test_rows_have_error_bars_words_and_a_way_to_measure_them(tmp_path):
    found = {"lost": {"mean": 2.5, "error": 0.25}, "verdict": "refuted", "count": 3}
    save_result(tmp_path / "study.json", found, "do it")
    numbers = Numbers({"noisy": {"walk": {"mpjpe_mm": 20.0}}}, tmp_path, "egocap-eval run quick")

    def row(**more):
        [made] = numbers.rows([PaperRow(section="5", statement="x", paper="2", **more)])
        return made

    lost = row(ours="study.json:lost.mean", error="study.json:lost.error")
    assert (lost["shown"], lost["ours"], lost["command"]) == ("2.5 +- 0.2", 2.5, "do it")
    assert row(ours="study.json:verdict")["shown"] == "refuted"
    assert row(ours="noisy/walk/mpjpe_mm")["command"] == "egocap-eval run quick"
    later = row(ours="later.json:x", command="egocap-eval later")
    assert (later["shown"], later["command"]) == ("-", "egocap-eval later")
    assert row(ours="study.json:verdict", less="study.json:count")["shown"] == "refuted"


def test_a_suite_can_be_tried(place, capsys):
    folder, _ = place
    text = (folder / "small.toml").read_text() + '[[studies]]\nname = "visibility"\n'
    (folder / "tried.toml").write_text(text)
    tried = ["run", str(folder / "tried.toml"), "--work", str(folder / "tried"), "--frames", "3"]
    assert main(tried) == 0  # neither the study nor the threshold count
    result = load_result(folder / "tried/scores.json")["result"]
    assert result["suite"]["name"] == "small-3" and result["suite"]["studies"] == []
    assert len(result["scores"]["noisy"]["walk"]["seeds"]) == 1
    assert main([*tried[:-1], "1"]) == 2
    assert "--frames 1" in capsys.readouterr().err


def test_numbers_are_looked_up_in_results(tmp_path):
    save_result(tmp_path / "detector.json", {"rows": [{"pck20": 91.5}], "name": "x"}, "do it")
    numbers = Numbers({}, tmp_path)
    assert numbers.find("detector.json:rows.0.pck20") == (91.5, "do it")
    assert numbers.find("detector.json:rows.1.pck20")[0] is None
    assert numbers.find("detector.json:name") == ("x", "do it")
    assert "detector.json: 'rows' is [" in numbers.find("detector.json:rows")[1]
    assert numbers.find("never.json:pck20") == (None, "not measured yet")


@pytest.mark.parametrize("key", ["tracker", "detections"])
def test_a_suite_runs_no_code_that_it_names_unless_allowed(place, tmp_path, capsys, key):
    ran = types.ModuleType("named_code")
    ran.calls = []
    ran.run = lambda *given: ran.calls.append(given)
    sys.modules["named_code"] = ran
    named = {"tracker": "named_code:run", "detections": "detector:named_code:run"}[key]
    head = (place[0] / "small.toml").read_text().split("[[methods]]")[0]
    suite = tmp_path / "code.toml"
    suite.write_text(f'{head}[[methods]]\nname = "code"\n{key} = "{named}"\n')
    words = ["run", str(suite), "--work", str(tmp_path / "out")]
    try:
        assert main(words) == 2
        line = capsys.readouterr().err
        assert "methods.code" in line and "--allow-code" in line
        assert not ran.calls and not (tmp_path / "out").exists()
        assert main([*words, "--allow-code"]) == 2  # it returns no poses
        assert ran.calls
    finally:
        del sys.modules["named_code"]
