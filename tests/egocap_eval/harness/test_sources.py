"""A source's hash changes with its code, not with its words."""

import pytest

from egocap.errors import FileError
from egocap_eval.harness import sources
from egocap_eval.harness.sources import locate, python_hash, source_hashes

CODE = '''"""Module."""
LIMIT = 3
"""Why three."""

def f(x: int) -> int:
    """Doc."""
    return x + 1  # one more
'''


def test_words_and_layout_do_not_count():
    other = CODE.replace("Doc.", "Better words.").replace("  # one more", "").replace("Module", "M")
    assert python_hash(other.replace("x + 1", "(x\n     + 1)")) == python_hash(CODE)


@pytest.mark.parametrize("change", [("+ 1", "+ 2"), ("= 3", "= 4"), ("x +", "x -"), ("f(", "g(")])
def test_code_counts(change):
    assert python_hash(CODE.replace(*change)) != python_hash(CODE)


def test_text_in_use_counts():
    assert python_hash('print("a")') != python_hash('print("b")')


def test_paths_are_packages_or_of_the_repository():
    found = source_hashes(["egocap/track", "egocap_eval/harness/sources.py"])
    assert len(set(found.values())) == 2 and all(len(v) == 16 for v in found.values())
    assert locate("egocap/track").is_dir()
    with pytest.raises(FileError, match="no such source"):
        source_hashes(["egocap/no_such_room"])


def test_modules_are_left_out_by_name(tmp_path, monkeypatch):
    for name in ("solver", "report"):
        (tmp_path / f"{name}.py").write_text("x = 1\n")
    monkeypatch.setattr(sources, "locate", lambda path: tmp_path)

    def hashes():
        sources._path_hash.cache_clear()
        sources.file_hash.cache_clear()
        return source_hashes(["room", "room!report", "room!report,other"])

    before = hashes()
    (tmp_path / "report.py").write_text("x = 2\n")
    assert [name for name, value in hashes().items() if value != before[name]] == ["room"]
    (tmp_path / "solver.py").write_text("x = 2\n")
    assert all(value != before[name] for name, value in hashes().items())
    sources._path_hash.cache_clear()
