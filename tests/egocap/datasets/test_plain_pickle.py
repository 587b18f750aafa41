"""Plain pickles give what `pickle` gives; anything that would run code or eat memory is refused."""

import os
import pickle
import resource
import struct
from collections import OrderedDict
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.datasets.plain_pickle import load_plain_pickle
from egocap.errors import FileError

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
RECORDS = [
    {"ext_id": 503, "ego_pose_gt": np.arange(45.0).reshape(15, 3), "image_name": "img_000001.jpg"},
    {"ext_id": np.int64(504), "ego_pose_gt": None, "flag": True, "t": (1, "\u00fc"), "b": b"x"},
    {"f32": np.float32(1.5), "order": np.asfortranarray(np.arange(6, dtype=">f4").reshape(2, 3)),
     "text": np.array(["a", "bcd"]), "none": np.zeros((0, 3)), "big": 1 << 100},
]  # fmt: skip


def read(tmp_path, content: bytes):
    path = tmp_path / "data.pkl"
    path.write_bytes(content)
    return load_plain_pickle(path)


def assert_equal(found, expected):
    if isinstance(expected, np.ndarray):
        assert isinstance(found, np.ndarray) and found.shape == expected.shape
        assert np.array_equal(found, expected) and found.dtype == expected.dtype
    elif isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            assert_equal(found[key], expected[key])
    elif isinstance(expected, list | tuple):
        assert type(found) is type(expected) and len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_equal(one, other)
    else:
        assert found == expected


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_records_of_data_sets_are_read_as_pickle_reads_them(protocol, tmp_path):
    assert_equal(read(tmp_path, pickle.dumps(RECORDS, protocol)), RECORDS)
    shared = np.ones((2, 2))
    found = read(tmp_path, pickle.dumps({"a": shared, "b": [shared, OrderedDict(c=1)]}, protocol))
    assert_equal(found["b"], [shared, {"c": 1}])


numbers = st.booleans() | st.integers() | st.floats(allow_nan=False)
plain = st.recursive(
    st.none() | numbers | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=20,
)


@settings(max_examples=60, deadline=None)
@given(value=plain, protocol=st.sampled_from(PROTOCOLS))
def test_any_plain_data_is_read_as_pickle_reads_it(value, protocol, tmp_path_factory):
    assert_equal(read(tmp_path_factory.mktemp("p"), pickle.dumps(value, protocol)), value)


class Runs:
    """Pickled as a call."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def nested_reduce(marker: str) -> bytes:
    """A call whose function is the result of a call."""
    inner = b"cbuiltins\ngetattr\n(cbuiltins\n__import__\n(Vos\ntRVsystem\ntR"
    return inner + f"(Vtouch {marker}\ntR.".encode()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_no_code_of_a_file_runs(protocol, tmp_path):
    marker = tmp_path / "ran"
    attacks = [
        Runs(os.system, f"touch {marker}"),
        Runs(eval, f"open({str(marker)!r}, 'w')"),
        [1, {"a": Runs(exec, f"open({str(marker)!r}, 'w')")}],
        Runs(np.load, str(marker)),
        Runs(np.fromfile, str(marker)),
        Runs(bytearray, 1 << 40),
        Runs(np.zeros, (1 << 40,)),
        np.array([Runs(os.system, f"touch {marker}")], object),
    ]
    for attack in attacks:
        with pytest.raises(FileError, match="plain data"):
            read(tmp_path, pickle.dumps(attack, protocol))
    assert not marker.exists()


@pytest.mark.parametrize(
    "content",
    [
        b"cos\nsystem\n(Vtrue\ntR.",  # GLOBAL, REDUCE
        b"(cos\nsystem\nVtrue\no.",  # OBJ
        b"(Vtrue\nios\nsystem\n.",  # INST
        b"\x80\x02cos\nsystem\nVtrue\n\x85\x81.",  # NEWOBJ
        b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x04true\x85R.",  # STACK_GLOBAL
        b"\x80\x02\x82\x01.",  # EXT1
        b"Vtrue\nQ.",  # BINPERSID
        b"cnumpy\nndarray\n(I1000000000000\ntR.",  # the class itself is not callable
        b"cnumpy\nndarray\n(I1000000000000\nt\x81.",
        b"cnumpy\ndtype\n(VO8\ntR.",
        b"cnumpy\ndtype\n(Vf8,100000000000f8\ntR.",
        b"c_codecs\nencode\n(Vaaaa\nVzlib\ntR.",
        b"(lp0\n(Vx\nd" + b"b.",  # BUILD of a list
        nested_reduce("/tmp/egocap-nested-reduce"),
    ],
)
def test_opcodes_that_make_objects_are_refused(content, tmp_path):
    with pytest.raises(FileError):
        read(tmp_path, content)


@pytest.mark.parametrize(
    "content",
    [
        b"\x80\x05\x96" + struct.pack("<Q", 1 << 45) + b"x.",  # BYTEARRAY8 of 32 TB
        b"\x80\x04\x8e" + struct.pack("<Q", 1 << 45) + b"x.",  # BINBYTES8
        b"\x80\x02Nr" + struct.pack("<I", (1 << 32) - 1) + b".",  # LONG_BINPUT far out
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I1000000000000\ntVb\ntR.",
        b"cnumpy.core.multiarray\n_reconstruct\n(tR(I1\n(I1000000000000\ntcnumpy\ndtype\n"
        b"(Vf8\ntRI00\nVabcdefgh\ntb.",
        b"I" + b"9" * 100_000 + b"\n.",
        b"(" * 200_000 + b"t" * 200_000 + b".",
    ],
)
def test_stated_sizes_allocate_nothing(content, tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with suppress(FileError):
        read(tmp_path, content)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KB


@settings(max_examples=200, deadline=None)
@given(where=st.integers(0, 10_000), byte=st.integers(0, 255), cut=st.integers(0, 10_000))
def test_damage_is_an_error_or_harmless(where, byte, cut, tmp_path_factory):
    content = bytearray(pickle.dumps(RECORDS))
    content[where % len(content)] = byte
    with suppress(FileError):
        read(tmp_path_factory.mktemp("d"), bytes(content[: cut % len(content)] or content))
