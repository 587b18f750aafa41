"""One small sequence and one cluster for the whole session: used by many tests, changed by none."""

from __future__ import annotations

import re
import signal
import warnings
from collections.abc import Generator, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from egocap.errors import MachineError
from egocap_sim.core.resources import builtin_file
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene, load_scene

settings.register_profile("same", derandomize=True)  # examples depend on the test alone
settings.load_profile("same")
signal.signal(signal.SIGINT, signal.default_int_handler)  # nohup ignores it, and tests send it

_NEEDS_TORCH = re.compile(
    r"^(import torch|from torch|from safetensors.torch"
    r"|from egocap.detect.(network|train.(loss|trainer|run|validation|checkpoint)) "
    r"|from egocap_eval.(detection.train_for_rig|image_model.exactness) )",
    re.MULTILINE,
)


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Leave out the test files that import torch, an extra, where it is not installed."""
    if collection_path.suffix != ".py" or find_spec("torch") is not None:
        return None
    return bool(_NEEDS_TORCH.search(collection_path.read_text())) or None


def pytest_report_header() -> str | None:
    """Say so."""
    return None if find_spec("torch") else "without torch: tests that use it are left out"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the long files, so that no process waits for another's at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    """Skip tests that use torch in the course of their work, or whose fixtures do."""
    try:
        return (yield)
    except (ModuleNotFoundError, MachineError) as error:
        if find_spec("torch") is None and "'torch'" in str(error):
            pytest.skip(str(error))
        raise


pytest_runtest_call = pytest_runtest_setup


@pytest.fixture(scope="session")
def tiny_scene() -> Scene:
    """The first 7 frames of validation-walk at 160 x 128, in shards of 2, with depth."""
    scene = load_scene(builtin_file("scene", "validation-walk")).model_dump()
    scene["frames"], scene["rig"]["size"] = 7, (160, 128)
    scene["record"] |= {"shard_frames": 2, "depth": True}
    return Scene.model_validate(scene)


@pytest.fixture(scope="session")
def tiny_sequence(tiny_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of its sequence; copy it before changing anything."""
    folder = tmp_path_factory.mktemp("tiny") / "sequence"
    try:
        generate(tiny_scene, folder, workers=1)
    except MachineError as error:
        warnings.warn(f"NO TEST OF SEQUENCES RUNS HERE: {error}", stacklevel=1)
        pytest.skip(f"no OpenGL: {error}")
    return folder


@pytest.fixture
def no_lines_by_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command prints depends on what it does, not on how fast the machine is."""
    monkeypatch.setattr("egocap.commandline._EVERY_S", 1e6)


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a Dask scheduler with one worker, both in threads of this process, which end."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, processes=False, dashboard_address=":0", silence_logs=50
    ) as running:
        yield running.scheduler_address
