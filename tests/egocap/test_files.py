"""npz archives: whole archives of plain arrays only, refused before anything is allocated."""

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from egocap.errors import FileError
from egocap.files import read_bytes, read_npz, write_npz
from tests.egocap.conftest import peak_below


def npy(header: str, content: bytes = b"") -> bytes:
    """A version 1.0 .npy file with this header."""
    text = header.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content


def archive(path: Path, *members: tuple[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members:
            file.writestr(name, content)
    return path


def array(value) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


def test_devices_and_links_to_them_are_read_up_to_the_limit(tmp_path):
    (tmp_path / "zero.json").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(FileError, match=r"zero.json: has more than 1,000 bytes"):
        read_bytes(tmp_path / "zero.json", 1000)
    for name, says in (("loop", "symbolic links"), ("none", "no such file"), ("", "is a folder")):
        with pytest.raises(FileError, match=says):
            read_bytes(tmp_path / name)
    (tmp_path / "whole").write_bytes(b"12345")
    assert read_bytes(tmp_path / "whole", 5) == b"12345"


def test_arrays_come_back_as_written(tmp_path):
    written = {"a": np.arange(6.0).reshape(2, 3), "text": np.array("x"), "flags": np.zeros(0, bool)}
    write_npz(tmp_path / "a.npz", **written)
    found = read_npz(tmp_path / "a.npz")
    assert found.keys() == written.keys()
    for name, value in written.items():
        assert found[name].dtype == value.dtype
        np.testing.assert_array_equal(found[name], value)
    assert read_npz(tmp_path / "a.npz", only=("text", "other")).keys() == {"text"}


@pytest.mark.parametrize(
    ("member", "message"),
    [
        (("a.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (10**6, 10**9), }")),
         "not a whole npz"),
        (("a.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }")),
         "not the size of its shape"),
        (("a.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-2,), }")), "shape"),
        (("a.npy", npy("{'descr': '<U0', 'fortran_order': False, 'shape': (9000000000,), }")),
         "type"),
        (("a.npy", array([{"an": "object"}])), "type object"),
        (("a.npy", b"no array"), "not a whole npz"),
        (("a.npy", b""), "not a whole npz"),
        (("readme.txt", b"text"), "is not an array"),
    ],
)  # fmt: skip
def test_members_that_are_no_plain_array_are_refused(tmp_path, member, message):
    path = archive(tmp_path / "a.npz", member)
    with peak_below(1 << 22), pytest.raises(FileError, match=message):
        read_npz(path)


def test_an_array_that_is_not_asked_for_is_not_read(tmp_path):
    path = archive(tmp_path / "a.npz", ("a.npy", array(3.0)), ("b.npy", b"damaged"))
    assert read_npz(path, only=("a",)) == {"a": 3.0}


def test_archives_that_unpack_to_much_more_than_their_size_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    write_npz(path, a=np.zeros(1 << 17))
    assert read_npz(path)["a"].shape == (1 << 17,)
    monkeypatch.setattr("egocap.files.ALWAYS_UNPACKED", 1 << 16)
    with pytest.raises(FileError, match="unpacks to 1,048,704 bytes, at most 65,536"):
        read_npz(path)


def test_encrypted_and_unknown_compression_are_refused(tmp_path):
    path = archive(tmp_path / "a.npz", ("a.npy", array(1.0)))
    content = bytearray(path.read_bytes())
    directory = content.rindex(b"PK\x01\x02")
    for offset, value, message in ((8, 1, "encrypted"), (10, 99, "compression 99")):
        changed = content.copy()
        changed[directory + offset] = value
        path.write_bytes(changed)
        with pytest.raises(FileError, match=message):
            read_npz(path)


def test_a_bare_array_and_two_members_of_one_name_are_refused(tmp_path):
    bare = tmp_path / "bare.npz"
    bare.write_bytes(array([1.0, 2.0]))
    with pytest.raises(FileError, match="not a whole npz archive"):
        read_npz(bare)
    with pytest.warns(UserWarning, match="Duplicate name"):
        twice = archive(tmp_path / "t.npz", ("a.npy", array(1.0)), ("a.npy", array(2.0)))
    with pytest.raises(FileError, match="two members of one name"):
        read_npz(twice)
