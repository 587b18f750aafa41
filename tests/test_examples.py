"""The examples run and use public names only."""

import ast
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
