"""Hashes of source files, for telling whether a result is of the code at hand.

Paths are relative to the repository, `egocap_eval` standing for its package wherever it lies. A
folder stands for all files in it, and a pattern (`egocap/detect/*.py`) for the files it matches;
`egocap/track!consistency` leaves modules out, by their names with commas between them.
Python is hashed by its syntax tree: comments, docstrings and layout do not count.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from egocap.errors import FileError

PACKAGES = ("egocap", "egocap_sim", "egocap_eval")


def source_hashes(paths: Iterable[str]) -> dict[str, str]:
    """A short hash of each path's content, by path. Raises FileError for a path that is absent."""
    return {path: _path_hash(path) for path in paths}


def locate(path: str) -> Path:
    """File, folder or pattern of a source path. Raises FileError if there is none."""
    package, _, rest = path.partition("/")
    if package in PACKAGES:
        spec = find_spec(package)
        assert spec is not None and spec.submodule_search_locations
        found = Path(spec.submodule_search_locations[0]) / rest
    else:
        found = Path(__file__).parents[3] / path
    if not (found.exists() or any(found.parent.glob(found.name))):
        raise FileError(found, "no such source file or folder")
    return found


def python_hash(text: str) -> str:
    """Hash of a Python module by its syntax tree, without docstrings."""
    digest = hashlib.sha256()
    for word in _words(ast.parse(text)):
        digest.update(word.encode() + b"\0")
    return digest.hexdigest()


@cache
def _path_hash(path: str) -> str:
    kept, _, left_out = path.partition("!")
    found, names = locate(kept), left_out.split(",")
    matched = found.rglob("*") if found.is_dir() else found.parent.glob(found.name)
    files = sorted(p for p in matched if _counts(p) and p.stem not in names)
    lines = (f"{file.relative_to(found.parent)} {file_hash(file)}" for file in files)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def _counts(path: Path) -> bool:
    return path.is_file() and "__pycache__" not in path.parts and not path.name.startswith(".")


@cache
def file_hash(path: Path) -> str:
    """SHA-256 of a file; of Python, of its syntax tree."""
    content = path.read_bytes()
    if path.suffix == ".py":
        return python_hash(content.decode())
    return hashlib.sha256(content).hexdigest()


def _words(node: Any) -> Iterator[str]:
    """The tree as words. Empty fields are left out: their set differs among Python versions."""
    if isinstance(node, ast.AST):
        yield type(node).__name__
        for name, value in ast.iter_fields(node):
            if name == "body" and isinstance(value, list):
                value = [v for v in value if not _is_text(v)]
            if value not in (None, []):
                yield name
                yield from _words(value)
    elif isinstance(node, list):
        yield "["
        for item in node:
            yield from _words(item)
        yield "]"
    else:
        yield repr(node)


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a text alone: a docstring, or one below an attribute."""
    return (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str))  # fmt: skip
