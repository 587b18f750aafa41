"""A tiny network with random weights, for all that does not depend on what it has learned."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def tiny_file(tmp_path_factory) -> Path:
    torch = pytest.importorskip("torch")
    from egocap.detect.network import CONFIGS, build_network
    from egocap.detect.weights import save_weights

    torch.manual_seed(3)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(path, build_network(CONFIGS["tiny"]), {"command": "none"})
    return path


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory):
    """No test of networks writes into the user's cache, which others read."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("egocap.detect.engine.cache_folder", lambda: folder)
        yield
