"""The examples run and use public names only."""

import ast
import json
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
FILES = sorted(EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_imports_are_of_the_first_two_levels(path):
    for node in ast.walk(ast.parse(path.read_text())):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) else []
        for name in names:
            assert not name.startswith("egocap") or name.count(".") <= 1, name


def test_quickstart(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))
    import quickstart

    monkeypatch.setattr(sys, "argv", ["quickstart.py"])
    quickstart.main()
    told = capsys.readouterr().out
    assert "Track(60 frames" in told and "MPJPE" in told


def test_notebook_runs_and_keeps_no_output(tmp_path, monkeypatch, capsys):
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    plt.close("all")
    cells = json.loads((EXAMPLES / "tutorial.ipynb").read_text())["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, cell["id"]
        *lines, last = ast.parse("".join(cell["source"])).body
        exec(compile(ast.Module(lines, []), cell["id"], "exec"), names)
        shown = isinstance(last, ast.Expr)
        code = compile(ast.Expression(last.value) if shown else ast.Module([last], []),
                       cell["id"], "eval" if shown else "exec")  # fmt: skip
        found = eval(code, names)
        if hasattr(found, "_repr_html_"):
            assert found._repr_html_().startswith("<")
    assert len(plt.get_fignums()) == 4
    plt.close("all")
    assert "MPJPE" in capsys.readouterr().out and names["posterior"].converged
