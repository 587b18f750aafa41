"""The configuration of a sequence as its manifest holds it: resolved, without paths."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from egocap.cameras.rig import Rig
from egocap.errors import FileError
from egocap_sim.scene.config import Scene

_OMITTED = (
    ("motion", "mirrored", False),
    ("motion", "speed", 1.0),
    ("motion", "then_start_s", 0.0),
    ("sensor", "subframe_sharpness", 1.0),
)
"""Keys left out at their default, which keeps the hash of sequences made before they existed."""


def resolve_config(scene: Scene, rig: Rig) -> dict[str, Any]:
    """All that the content of a sequence depends on. Files are given by name and checksum.

    Raises FileError for a file that cannot be read.
    """
    config = scene.model_dump(mode="json", exclude_none=True)
    for table, key, default in _OMITTED:
        if config.get(table, {}).get(key) == default:
            del config[table][key]
    config["rig"] = rig.to_dict()
    for table, key in (
        ("motion", "file"), ("motion", "joint_names"), ("motion", "then"), ("place", "panorama"),
    ):  # fmt: skip
        if path := config[table].pop(key, None):
            config[table][key] = {"name": Path(path).name, "sha256": _checksum(Path(path))}
    if folder := config["place"].pop("textures", None):
        from egocap_sim.environment.texture_folder import picture_files

        config["place"]["textures"] = {p.name: _checksum(p) for p in picture_files(Path(folder))}
    return config


def _checksum(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
