"""The public names of `egocap` and `egocap_sim`: there, lazy, and declared to type checkers."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = [importlib.import_module(name) for name in ("egocap", "egocap_sim")]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_public_names_load_and_have_docstrings(package):
    for name in package.__all__:
        found = getattr(package, name)
        assert found.__name__ == name and found.__doc__, name
        assert getattr(package, name) is found
        assert name in dir(package)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = package.no_such_name


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_stub_declares_the_public_names_from_the_same_modules(package):
    tree = ast.parse(Path(package.__file__).with_suffix(".pyi").read_text())
    declared = {
        alias.asname: node.module
        for node in tree.body if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }  # fmt: skip
    assert declared == {
        name: f"{package.__name__}.{module}" for name, module in package._MODULES.items()
    }


def test_no_room_takes_the_place_of_a_public_name():
    for package in PACKAGES:
        rooms = {path.stem for path in Path(package.__file__).parent.iterdir()}
        assert not rooms & set(package.__all__)


def test_import_is_fast():
    script = "import time; s = time.perf_counter(); import egocap; print(time.perf_counter() - s)"
    runs = [subprocess.run([sys.executable, "-c", script], capture_output=True) for _ in range(3)]
    assert min(float(run.stdout) for run in runs) < 0.2
