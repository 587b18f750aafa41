"""The command egocap, and a smooth made-up motion seen by the paper's rig at 640 x 512."""

import json
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egocap import cli
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.detect.synthetic import ProjectedJoints, simulate_detections
from egocap.pose.pose_prior import load_posture

RIG = Path(__file__).parents[2] / "scenes/rigs/egorig1.toml"
FPS = 30.0


@pytest.fixture
def egocap(monkeypatch, capsys, tmp_path, no_lines_by_the_clock):
    """Run egocap in an empty folder; gives its exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["egocap", *map(str, words)])
        code = cli.main()
        return code, *capsys.readouterr()

    return run


@dataclass(frozen=True, eq=False)
class Motion:
    rig: Rig
    person: Proportions
    times: np.ndarray
    angles: np.ndarray
    joints: np.ndarray

    def detect(self, source, *, hidden=0.0, seed=0):
        """Detections of the motion; a share of the joints is hidden in each view."""
        pixels, seen = self.rig.project(self.joints)
        pixels, seen = np.moveaxis(pixels, 0, 1), np.moveaxis(seen, 0, 1)
        rng = np.random.default_rng(seed)
        visible = seen & (rng.random(seen.shape) >= hidden)
        camera = self.rig.mounts[0].camera
        size = camera.width, camera.height
        joints = ProjectedJoints(pixels, visible, seen, self.times, size)
        return simulate_detections(joints, source, rng)

    def errors(self, track):
        """Distance of the 17 evaluated joints from the truth, metres (T, 17)."""
        return np.linalg.norm(track.joints_head - self.joints, axis=-1)[:, 1:]


@contextmanager
def peak_below(most: float) -> Iterator[None]:
    """Assert that less than `most` bytes are held at any time of what is allocated inside."""
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < most


def rewritten(file: Path, change: Callable[[Any], object], to: Path | None = None) -> Path:
    """A JSON file after a change of its content, in place or written to another path."""
    data = json.loads(file.read_text())
    change(data)
    path = to or file
    path.write_text(json.dumps(data))
    return path


def make_motion(frames=90, seed=0, extent=0.35, fps=FPS):
    rng = np.random.default_rng(seed)
    times = np.arange(frames) / fps
    rates = rng.uniform(0.2, 0.7, (3, 37))
    phases = rng.uniform(0, 2 * np.pi, (3, 37))
    waves = np.sin(2 * np.pi * rates * times[:, None, None] + phases).sum(1)
    angles = load_posture().mean + extent * SPREAD * waves / np.sqrt(1.5)
    angles = np.clip(angles, LIMITS[:, 0], LIMITS[:, 1])
    person = Proportions.from_lengths(1.75)
    rig = load_rig(RIG).resized(640, 512)
    return Motion(rig, person, times, angles, forward(person, angles))


@pytest.fixture(scope="session")
def motion():
    return make_motion()


@pytest.fixture(scope="session")
def slow_motion():
    """Twenty-one seconds."""
    return make_motion(168, seed=3, fps=8.0)


@pytest.fixture(scope="session")
def tiny_file(tmp_path_factory) -> Path:
    """A tiny network with random weights, for all that does not depend on what it has learned."""
    torch = pytest.importorskip("torch")
    from egocap.detect.network import CONFIGS, build_network
    from egocap.detect.weights import save_weights

    torch.manual_seed(3)
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    save_weights(path, build_network(CONFIGS["tiny"]), {"command": "none"})
    return path


@pytest.fixture(scope="session")
def empty_cache(tmp_path_factory):
    """A cache of exported networks of the tests alone: others read the user's."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("egocap.detect.engine.cache_folder", lambda: folder)
        yield
