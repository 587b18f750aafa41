"""The mutation tool's bookkeeping; the run itself takes most of an hour."""

import importlib.util
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOUND = {
    "mutants": 10,
    "survivors": {
        "a.b.x_first__mutmut_3": {"state": "survived", "change": ["-    x = 1", "+    x = 2"]},
        "a.b.xǁKindǁ__init____mutmut_12": {"state": "no tests", "change": ["-    y", "+    z"]},
    },
}


@pytest.fixture(scope="module")
def tool():
    spec = importlib.util.spec_from_file_location("mutation", ROOT / "tools/mutation.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_explained_survivors_are_listed_apart_and_both_scores_are_given(tool):
    entry = {"function": "first", "change": "\n-    x = 1\n+    x = 2\n", "reason": "no one asks"}
    result, unused = tool.judge(FOUND, [entry])
    assert (result["killed"], result["score"], result["adjusted"]) == (8, 0.8, 0.8889)
    assert list(result["survivors"]) == ["a.b.xǁKindǁ__init____mutmut_12"]
    (explained,) = result["equivalents"].values()
    assert explained["reason"] == "no one asks" and unused == []
    both = tool.total({"a": result, "b": result})
    assert both == {"mutants": 20, "killed": 16, "equivalent": 2, "score": 0.8, "adjusted": 0.8889}


@pytest.mark.parametrize(
    "change", [{"function": "second"}, {"change": "-    x = 1\n+    x = 3"}], ids=str
)
def test_explanation_of_another_function_or_change_explains_nothing(tool, change):
    entry = {"function": "first", "change": "-    x = 1\n+    x = 2", "reason": ""} | change
    result, unused = tool.judge(FOUND, [entry])
    assert result["equivalent"] == 0 and unused == [entry]
    assert result["score"] == result["adjusted"] == 0.8


def test_names_of_functions_and_methods(tool):
    assert tool.function_of("a.b.x_first__mutmut_3") == "first"
    assert tool.function_of("a.b.x__private__mutmut_1") == "_private"
    assert tool.function_of("a.b.xǁKindǁ__init____mutmut_12") == "Kind.__init__"


def test_explained_lines_are_in_their_modules(tool):
    explained = tomllib.loads(tool.EQUIVALENTS.read_text(encoding="utf-8"))
    assert set(explained) <= set(tool.MODULES)
    for module, entries in explained.items():
        code = (ROOT / module).read_text(encoding="utf-8").splitlines()
        for entry in entries:
            assert set(entry) == {"function", "change", "reason"} and entry["reason"]
            taken = [line[1:] for line in entry["change"].splitlines() if line[:1] == "-"]
            assert taken and {line.strip() for line in taken} <= {line.strip() for line in code}
