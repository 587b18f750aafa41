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


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.__name__)
def test_import_loads_nothing_else(package):
    """Names load their modules when they are first used, so that an import costs milliseconds."""
    name, root = package.__name__, Path(package.__file__).parents[1]
    script = (f"import sys; sys.path.insert(0, {str(root)!r}); import {name}; "
              "print(*{m.split('.')[0] for m in sys.modules})")  # fmt: skip
    run = subprocess.run([sys.executable, "-I", "-S", "-c", script], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert set(run.stdout.split()) - sys.stdlib_module_names == {"__main__", name}
