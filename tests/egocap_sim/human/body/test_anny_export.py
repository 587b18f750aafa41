"""The table of shapes: atomic, versioned, rebuilt when damaged."""

import numpy as np
import pytest

from egocap.errors import MachineError
from egocap_sim.human.body import anny_export


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """An empty cache folder, a stand-in for the minute-long export, and no memory of others."""
    known = anny_export.shape_data()
    calls = []

    def export():
        calls.append(1)
        return {"vertices": np.arange(6.0).reshape(2, 3)}

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(anny_export, "adult_shapes", export)
    anny_export.shape_data.cache_clear()
    yield calls, tmp_path / "egocap"
    anny_export.shape_data.cache_clear()
    monkeypatch.undo()
    assert anny_export.shape_data().keys() == known.keys()


def test_built_once_then_read(fresh):
    calls, folder = fresh
    anny_export.shape_data()
    anny_export.shape_data.cache_clear()
    assert anny_export.shape_data()["vertices"].shape == (2, 3)
    assert len(calls) == 1
    assert [p.name for p in folder.iterdir()] == [f"adult-shapes-{anny_export.FORMAT}.npz"]


def test_damaged_file_is_built_again(fresh):
    calls, folder = fresh
    anny_export.shape_data()
    file = next(folder.iterdir())
    file.write_bytes(file.read_bytes()[:100])
    anny_export.shape_data.cache_clear()
    assert anny_export.shape_data()["vertices"].shape == (2, 3)
    assert len(calls) == 2


def test_unwritable_folder_is_named(fresh, monkeypatch, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocker))
    with pytest.raises(MachineError, match="XDG_CACHE_HOME"):
        anny_export.shape_data()
