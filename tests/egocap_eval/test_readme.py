"""Every committed result says how it was made, and the README says what that costs."""

from pathlib import Path

import pytest

from egocap_eval.harness.result_file import load_result
from egocap_eval.harness.thresholds import COMMITTED

README = (Path(__file__).parents[2] / "evals/README.md").read_text()
RESULTS = sorted(COMMITTED.glob("*.json"))


@pytest.mark.parametrize("path", RESULTS, ids=lambda p: p.name)
def test_result_has_its_row_and_its_provenance(path):
    assert f"| `{path.name}` | `" in README, path.name
    record = load_result(path)
    assert record["command"].startswith(("egocap-eval ", "python "))
    assert record["machine"]["cores"] and record["date"]


def test_pictures_belong_to_results():
    for picture in COMMITTED.glob("*.png"):
        assert picture.with_suffix(".json").is_file(), picture.name
