"""Stores of the tests: one in memory, and a server that speaks S3."""

import fsspec
import pytest


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, as on another machine."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def store(cache):
    """The file system behind memory:// addresses, empty."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs[:] = [""]
    yield system
    system.store.clear()
