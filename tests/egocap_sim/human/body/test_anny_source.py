"""The cache file of body shapes: atomic, versioned, rebuilt when damaged."""

import numpy as np
import pytest

from egocap.errors import MachineError
from egocap_sim.human.body import anny_source


@pytest.fixture
def fresh(monkeypatch, tmp_path):
    """An empty cache folder, a fast replacement of the export, and an empty in-memory cache."""
    known = anny_source.shape_data()
    calls = []

    def export():
        calls.append(1)
        return {"vertices": np.arange(6.0).reshape(2, 3)}

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(anny_source, "adult_shapes", export)
    anny_source.shape_data.cache_clear()
    yield calls, tmp_path / "egocap"
    anny_source.shape_data.cache_clear()
    monkeypatch.undo()
    assert anny_source.shape_data().keys() == known.keys()


def test_built_once_then_read(fresh):
    calls, folder = fresh
    anny_source.shape_data()
    anny_source.shape_data.cache_clear()
    assert anny_source.shape_data()["vertices"].shape == (2, 3)
    assert len(calls) == 1
    assert [p.name for p in folder.iterdir()] == [f"adult-shapes-{anny_source.FORMAT}.npz"]


def test_damaged_file_is_built_again(fresh):
    calls, folder = fresh
    anny_source.shape_data()
    file = next(folder.iterdir())
    file.write_bytes(file.read_bytes()[:100])
    anny_source.shape_data.cache_clear()
    assert anny_source.shape_data()["vertices"].shape == (2, 3)
    assert len(calls) == 2


def test_unwritable_folder_raises(fresh, monkeypatch, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocker))
    with pytest.raises(MachineError, match="XDG_CACHE_HOME"):
        anny_source.shape_data()
