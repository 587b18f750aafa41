"""Errors say where and what would be valid, and survive the way back from a worker process."""

import pickle

import pytest

from egocap.errors import EgocapError, FileError, InputError, MachineError


def test_a_file_error_names_file_key_and_valid_values():
    text = str(FileError("a.toml", "unknown key", key="rig.fow", valid=["fov", "size"]))
    assert text == "a.toml, key 'rig.fow': unknown key (valid: fov, size)"
    assert str(FileError("a.bvh", "not a number", line=7)) == "a.bvh, line 7: not a number"


@pytest.mark.parametrize(
    "error",
    [
        InputError("bad", valid="good"),
        FileError("f", "bad", line=3),
        MachineError("full", remedy="x"),
    ],
)
def test_errors_cross_process_boundaries(error):
    back = pickle.loads(pickle.dumps(error))
    assert type(back) is type(error) and str(back) == str(error)
    assert isinstance(back, EgocapError) and back.exit_code == error.exit_code


def test_exit_codes_tell_input_from_machine():
    assert InputError("x").exit_code == FileError("f", "x").exit_code == 2
    assert MachineError("x").exit_code == 1


def test_a_message_is_one_short_printable_line_whatever_it_quotes():
    text = str(FileError("a.json", "x\n" * 9000, key="\x1b[31m" + "k" * 9000, valid=["v"] * 9000))
    assert text.isprintable() and len(text) < 1400
    assert text.startswith("a.json, key '\\x1b[31mkkk")
