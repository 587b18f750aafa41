"""Result files: JSON with the command, commit, machine and date of its numbers."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from egocap.errors import FileError
from egocap.files import make_folder, write_atomically
from egocap.schema import read_json
from egocap_eval.harness.sources import file_hash, source_hashes
from egocap_eval.harness.study_sources import sources_of

SCHEMA = 1
PACKAGES = (
    "egocap", "numpy", "scipy", "torch", "mujoco", "PyOpenGL", "numba",
    "opencv-contrib-python-headless", "onnxruntime", "openvino",
)  # fmt: skip
_VECTORS = ("avx2", "avx512f", "avx_vnni", "avx512_vnni", "avx512_bf16", "amx_bf16", "asimd")
OUTPUTS = (":(top,exclude)evals/results", ":(top,exclude)evals/test_log.jsonl")
"""What studies write: changes there do not change what the code does."""


def save_result(
    path: str | Path,
    payload: Mapping[str, Any],
    command: str | Sequence[str],
    *,
    config: Mapping[str, Any] | None = None,
    seconds: Mapping[str, float] | None = None,
    stamp: Mapping[str, Any] | None = None,
) -> None:
    """Write a result with its provenance; the file appears whole or not at all.

    The file holds `schema`, `command`, `date` (UTC), `commit` (null outside a checkout, with
    '+changes' when the tree was not clean), `machine`, `versions` and the payload under `result`;
    `config`, `config_sha256` and `seconds` where they are given; of a study with declared sources
    (`study_sources`) their hashes, and that of the detector's weights if it is one of them.

    Args:
        path: a .json file; its folder is made if missing.
        payload: the numbers, JSON-ready, without NaN.
        command: the command line that reproduces them.
        config: everything the numbers depend on, JSON-ready; recorded with its hash.
        seconds: how long it took, `wall` and `cpu`.
        stamp: `code_stamp` from before the study ran; that of now when None.

    Raises:
        MachineError: the file cannot be written.
    """
    command = command if isinstance(command, str) else " ".join(command)
    stamp = code_stamp(command) if stamp is None else stamp
    record = {"schema": SCHEMA, "command": command, **provenance(), **stamp}
    if "weights" in stamp:
        record["weights"] = (config or {}).get("weights") or stamp["weights"]
    if config is not None:
        record |= {"config": plain(config), "config_sha256": config_hash(config)}
    if seconds is not None:
        record["seconds"] = {name: round(value, 1) for name, value in seconds.items()}
    record["result"] = dict(payload)
    write_text(path, json.dumps(record, indent=2, allow_nan=False) + "\n")


def load_result(path: str | Path) -> dict[str, Any]:
    """Read what `save_result` wrote; FileError for another file or a newer schema."""
    record = read_json(path)
    if not ({"schema", "command"} <= record.keys() and isinstance(record.get("result"), dict)):
        raise FileError(path, "not a result", valid="a file written with --out FILE.json")
    if not isinstance(record["schema"], int) or record["schema"] > SCHEMA:
        raise FileError(path, f"of schema {record['schema']}", key="schema",
                        valid=f"up to {SCHEMA}; upgrade egocap")  # fmt: skip
    return record


def config_hash(config: Mapping[str, Any]) -> str:
    """SHA-256 of a configuration, whatever the order of its keys."""
    text = json.dumps(plain(config), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Any:
    """A value as JSON has it: dataclasses and mappings as objects, paths as text."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return str(value) if isinstance(value, Path) else value


def provenance() -> dict[str, Any]:
    """Date, machine and versions, JSON-ready."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "cpu": cpu_model(),
            "vectors": _vectors(),
            "cores": os.cpu_count(),
            "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1),
            "system": f"{platform.system()} {platform.machine()}",
        },
        "versions": {"python": platform.python_version(), **_versions()},
    }


def git_commit() -> str | None:
    """Commit of the checkout this code runs from; None when it is an installed package."""
    folder = Path(__file__).resolve().parent
    head = _git(folder, "rev-parse", "HEAD")
    if head is None or _git(folder, "ls-files", "--error-unmatch", "result_file.py") is None:
        return None  # no repository, or another one around an installed copy
    changed = _git(folder, "status", "--porcelain", "-uno", "--", ":/", *OUTPUTS)
    return head + ("+changes" if changed else "")


def shipped_weights() -> str:
    """SHA-256 of the detector's weights that are shipped."""
    from egocap.detect.weights import shipped_file

    return file_hash(shipped_file())


def code_stamp(command: str) -> dict[str, Any]:
    """The code as it is now: commit, hashes of the study's sources, and the detector's weights
    where they are among them."""
    sources = sources_of(command)
    found: dict[str, Any] = {"commit": git_commit()}
    found |= {"sources": source_hashes(sources)} if sources else {}
    if any(path.startswith("egocap/detect/shipped") for path in sources):
        found["weights"] = shipped_weights()
    return found


def cpu_model() -> str:
    """Name of the processor."""
    return _cpu_info("model name") or platform.processor() or platform.machine()


def _vectors() -> list[str]:
    """Vector instructions of the processor on which the speed of a network depends."""
    known = _cpu_info("flags").split() + _cpu_info("Features").split()  # the latter on ARM
    return [name for name in _VECTORS if name in known]


def _cpu_info(key: str) -> str:
    """The first value of a key in Linux's list of processors; empty where there is none."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    pairs = (line.partition(":") for line in lines)
    return next((value.strip() for name, _, value in pairs if name.strip() == key), "")


def write_text(path: str | Path, text: str) -> None:
    """Write a text file that is whole or absent, in a folder made if missing."""
    path = Path(path)
    make_folder(path.parent)
    write_atomically(path, text.encode())


def _versions() -> dict[str, str]:
    found = {}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    if "egocap" not in found:  # run from a checkout that is not installed
        from egocap import __version__

        found["egocap"] = __version__
    return found


def _git(folder: Path, *words: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", *words], cwd=folder, capture_output=True, text=True, timeout=10, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None
