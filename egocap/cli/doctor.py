"""The command doctor: what this machine and installation provide."""

from __future__ import annotations

import json as jsons
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from egocap.cli.registry import app
from egocap.commandline import DONE, FAILED

if TYPE_CHECKING:
    from pathlib import Path

_PACKAGES = (
    "egocap", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "onnxruntime", "mujoco",
    "pyopengl",
)  # fmt: skip
_EXTRAS = {"train": "torch", "fast": "openvino", "people": "anny", "cluster": "distributed",
           "datasets": "h5py", "posterior": "arviz", "store": "fsspec",
           "view": "rerun", "world": "pycolmap"}  # fmt: skip
_LEAST_CACHE_MB = 200  # exported networks and motion files
_RUNS = 10  # of the network, timed


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    what: str
    found: str
    problem: str | None = None  # and how to mend it


@app.command
def doctor(json: bool = False) -> int:
    """Check this installation: versions, extras, OpenGL, cache, cameras, speed of the detector.

    Exit code 1 if something that the light install needs is missing.

    Args:
        json: print the findings as JSON.
    """
    findings = [*_versions(), _extras(), _opengl(), _cache(), _cameras(), _speed()]
    if json:
        print(jsons.dumps([asdict(finding) for finding in findings], indent=1))
    else:
        for finding in findings:
            print(f"{finding.what:32} {finding.found}")
            if finding.problem:
                print(f"{'':32} ! {finding.problem}")
    return FAILED if any(finding.problem for finding in findings) else DONE


def _versions() -> list[Finding]:
    import platform
    from importlib.metadata import PackageNotFoundError, version

    found = [Finding("python", platform.python_version())]
    for name in _PACKAGES:
        try:
            found.append(Finding(name, version(name)))
        except PackageNotFoundError:
            found.append(Finding(name, "missing", f"pip install {name}"))
    return found


def _extras() -> Finding:
    from importlib.util import find_spec

    there = [extra for extra, package in _EXTRAS.items() if find_spec(package)]
    absent = [extra for extra in _EXTRAS if extra not in there]
    text = f"{', '.join(there) or 'none'}; not installed: {', '.join(absent) or 'none'}"
    return Finding("extras", text)


def _opengl() -> Finding:
    """Whether the libraries load that the renderer of egocap-sim needs."""
    import ctypes

    missing = []
    for library in ("libEGL.so.1", "libGL.so.1"):
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(library)
    if missing:
        return Finding("OpenGL through EGL", f"{' and '.join(missing)} missing",
                       "on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri")  # fmt: skip
    return Finding("OpenGL through EGL", "libraries load")


def _cache() -> Finding:
    import os
    import shutil

    from egocap.files import cache_folder

    folder = cache_folder()
    there = _first_existing(folder)
    used = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file()) / 1e6
    free = shutil.disk_usage(there).free / 1e6
    problem = None
    if not os.access(there, os.W_OK):
        problem = "cannot be written; set XDG_CACHE_HOME to another folder"
    elif free < _LEAST_CACHE_MB:
        problem = f"less than {_LEAST_CACHE_MB} MB are free; set XDG_CACHE_HOME to another folder"
    return Finding("cache", f"{folder}: {used:.0f} MB, {free / 1000:.0f} GB free", problem)


def _first_existing(folder: Path) -> Path:
    """The folder, or its first parent that exists."""
    return next(path for path in (folder, *folder.parents) if path.exists())


def _cameras() -> Finding:
    from pathlib import Path

    names = []
    for device in sorted(Path("/sys/class/video4linux").glob("video*")):
        names.append(f"/dev/{device.name} ({(device / 'name').read_text().strip()})")
    return Finding("cameras", ", ".join(names) or "none")


def _speed() -> Finding:
    """Time of the network for one view."""
    import time

    import numpy as np

    from egocap.detect.engine import available_cores, open_engine
    from egocap.detect.weights import open_weights

    weights = open_weights()
    engine = open_engine(weights)
    view = np.zeros((1, weights.view.height, weights.view.width, 3), np.uint8)
    engine.run(view)
    start = time.perf_counter()
    for _ in range(_RUNS):
        engine.run(view)
    each = (time.perf_counter() - start) / _RUNS
    text = f"{engine.name}, {available_cores()} cores: {1000 * each:.0f} ms a view"
    return Finding("detector", text)
