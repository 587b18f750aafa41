"""Built-in files are found by name, anything else by path."""

from pathlib import Path

import pytest

from egocap.cameras.rig_files import load_rig
from egocap.errors import InputError
from egocap_sim.core.resources import builtin_file, builtin_names, find_file


def test_every_built_in_rig_loads_under_its_own_name() -> None:
    assert {"egorig1", "egorig2"} <= set(builtin_names("rig"))
    for name in builtin_names("rig"):
        assert load_rig(builtin_file("rig", name)).name == name


def test_names_and_paths_are_told_apart(tmp_path: Path, monkeypatch) -> None:
    assert find_file("rig", "egorig1").name == "egorig1.toml"
    assert find_file("rig", "mine/rig.toml") == Path("mine/rig.toml")
    monkeypatch.chdir(tmp_path)
    Path("egorig1").write_text("")
    assert find_file("rig", "egorig1") == Path("egorig1")


def test_an_unknown_name_lists_the_known() -> None:
    with pytest.raises(
        InputError, match=r"no built-in rig 'egorig9' \(valid: cap, ego4view, egorig1, egorig2"
    ):
        find_file("rig", "egorig9")
