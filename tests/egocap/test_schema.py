"""Reading and checking files: every error names file and key."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.errors import FileError
from egocap.schema import Number, Strict, checked, read_json, read_toml


class Inner(Strict):
    size: Number


class Outer(Strict):
    name: str
    inner: Inner | None = None
    several: tuple[Inner, ...] = ()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "key 'name': field required"),
        ({"name": "a", "inner": {"sise": 1}}, "key 'inner.sise': unknown key.* 1 more error"),
        ({"name": "a", "inner": {"size": 1, "x": 2}}, r"'inner.x': unknown key \(valid: size\)"),
        ({"name": "a", "several": [{"size": 1}, {"size": "b"}]}, r"'several.1.size': .*not 'b'"),
        ({"name": "a", "nome": 1}, r"unknown key \(valid: inner, name, several\)"),
        ({"name": "a", "inner": {"size": float("inf")}}, "'inner.size': .*finite"),
        ({"name": "a", "inner": {"size": -5e-324}}, "'inner.size': .*normal"),
        ({"name": "a", "inner": {"size": True}}, "'inner.size'"),
        (3, "file.toml: .*dictionary"),
    ],
)
def test_what_is_wrong_is_named(data, message) -> None:
    with pytest.raises(FileError, match=message):
        checked(Outer, data, "file.toml")


def test_good_data_passes_and_prefix_leads_the_key() -> None:
    assert checked(Outer, {"name": "a", "inner": {"size": 1}}, "f").inner == Inner(size=1.0)
    with pytest.raises(FileError, match=r"key 'mine\.name'"):
        checked(Outer, {}, "f", prefix="mine")


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(tmp_path_factory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("files") / "file"
    path.write_bytes(content)
    for read in (read_json, read_toml):
        try:
            read(path)
        except FileError as error:
            assert str(path) in str(error)


@pytest.mark.parametrize("value", ["[" * 200_000, "1" * 10_000, "{" * 10])
def test_extremes_are_refused(tmp_path: Path, value: str) -> None:
    path = tmp_path / "extreme"
    path.write_text(value)
    with pytest.raises(FileError, match="extreme"):
        read_json(path)
    path.write_text("a = " + value)
    with pytest.raises(FileError, match="extreme"):
        read_toml(path)


@pytest.mark.parametrize("text", ["a." * 100_000 + "b = 1", "[" + ".".join("k" * 40) + "]"])
def test_keys_of_many_parts_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "deep.toml"
    path.write_text(text)
    with pytest.raises(FileError, match="key of more than 32 parts"):
        read_toml(path)


def test_deep_nesting_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    for levels, good in ((31, True), (33, False)):
        path.write_text('{"a": ' + "[" * levels + "]" * levels + "}")
        if good:
            assert "a" in read_json(path)
        else:
            with pytest.raises(FileError, match="deeper than 32 levels"):
                read_json(path)


def test_a_large_text_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.toml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FileError, match=r"has 1,099,511,627,776 bytes \(valid: at most 4,194,304"):
        read_toml(path)


def test_the_byte_order_mark_of_some_editors_is_no_content(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfname = 'a'\n")
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"name": "a"}')
    assert read_toml(tmp_path / "a.toml") == read_json(tmp_path / "a.json") == {"name": "a"}
