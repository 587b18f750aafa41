"""README's and docs' tables are those of the committed results, and say what is stale."""

import json

import pytest

from egocap.errors import FileError, InputError
from egocap_eval.evidence import tables
from egocap_eval.evidence.page_table import ABSENT, NOTE, STALE, Results, Row, markdown
from egocap_eval.evidence.registry import ROOT, entries
from egocap_eval.evidence.result_tables import TABLES
from egocap_eval.evidence.tables import BLOCK, PAGES, study, with_tables
from egocap_eval.harness.result_file import save_result
from egocap_eval.harness.thresholds import COMMITTED


def unmarked(text):
    """A page without the marks of stale rows, which come and go with the code."""
    return text.replace(f"{NOTE} ", "").replace(f"{NOTE}\n\n", "").replace(STALE, "")


@pytest.mark.parametrize("page", PAGES)
def test_pages_hold_the_tables_of_the_committed_results(page):
    text = (ROOT / page).read_text()
    assert unmarked(text) == unmarked(with_tables(text, ROOT / page, Results())), "make tables"


def test_rows_of_other_weights_than_those_shipped_are_marked():
    results = Results()
    other = {file for file in entries() if "of other detector weights" in results[file].stale}
    for page in PAGES:
        for _, name, _ in BLOCK.findall((ROOT / page).read_text()):
            table = TABLES[name](results)
            if name != "reproduce" and any(results[file].entry.shown() in table for file in other):
                block = (ROOT / page).read_text().partition(f"<!-- table {name} -->")[2]
                assert NOTE in block.partition("<!-- end -->")[0], f"{page}, {name}: make tables"


def test_a_check_writes_nothing_and_names_the_pages(tmp_path, monkeypatch):
    for page in PAGES:
        (tmp_path / page).parent.mkdir(exist_ok=True)
        (tmp_path / page).write_text("<!-- table missed -->\nold\n<!-- end -->\n")
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    assert len(study(check=True).missed) == len(PAGES)
    assert "old" in (tmp_path / "README.md").read_text()
    assert not study().missed and not study(check=True).missed


def test_every_table_is_on_a_page():
    found = [name for page in PAGES for _, name, _ in BLOCK.findall((ROOT / page).read_text())]
    assert sorted(found) == sorted(TABLES)


@pytest.fixture
def folder(tmp_path):
    """A folder with a fresh result of the detector's speed, and one that is stale."""
    fresh = {"engines": {"torch": {"pairs_per_second": 27.34}, "cuda": {"missing": "none"}}}
    save_result(tmp_path / "detector_speed.json", fresh, "python benchmarks/detector.py")
    record = json.loads((tmp_path / "detector_speed.json").read_text())
    record["commit"] = "a" * 40
    (tmp_path / "detector_speed.json").write_text(json.dumps(record))
    old = json.loads((COMMITTED / "runtime.json").read_text())
    (tmp_path / "runtime.json").write_text(json.dumps(old | {"sources": {"egocap/body": "0"}}))
    return tmp_path


def test_rows_of_stale_results_are_marked(folder):
    text = TABLES["speed"](Results(folder))
    assert "| detector alone, torch | 27.3 |" in text and "cuda" not in text
    assert all(line.split("|")[1].rstrip().endswith("†") for line in text.splitlines()
               if line.startswith(("| images", "| tracker")))  # fmt: skip
    assert NOTE in text and "- `python benchmarks/detector.py`" in text


def test_a_missing_result_has_a_row_that_says_so(folder):
    text = TABLES["coverage"](Results(folder))
    assert f"| the posterior's own model | {ABSENT} |" in text and NOTE not in text
    with pytest.raises(InputError, match="no result 'nothing"):
        Results(folder)["nothing.json"]


def test_a_table_of_quoted_numbers_has_no_command(folder):
    text = markdown(("a", "b"), [Row(None, ("x", "1"))], Results(folder))
    assert text.splitlines()[:3] == ["| a | b |", "| --- | ---: |", "| x | 1 |"]


def test_only_what_is_between_markers_is_replaced(folder):
    page = "before\n<!-- table speed -->\nold\n<!-- end -->\nafter\n"
    text = with_tables(page, folder / "page.md", Results(folder))
    assert text.startswith("before\n<!-- table speed -->\n\n| speed") and "old" not in text
    assert text.endswith("\n<!-- end -->\nafter\n")
    assert with_tables(text, folder / "page.md", Results(folder)) == text
    with pytest.raises(FileError, match="no table 'nothing'"):
        with_tables(page.replace("speed", "nothing"), folder / "page.md", Results(folder))
