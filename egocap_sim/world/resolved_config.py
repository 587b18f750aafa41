"""The configuration of a sequence in its manifest: resolved and without paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from egocap.cameras.rig import Rig
from egocap.files import sha256
from egocap_sim.scene.config import Scene

_OMITTED = (
    ("motion", "mirrored", False),
    ("motion", "speed", 1.0),
    ("motion", "then_start_s", 0.0),
    ("sensor", "subframe_sharpness", 1.0),
    *(("sensor", key, 0.0) for key in ("tone", "warmth_ev", "rim", "glare", "aberration")),
    ("sensor", "saturation", 1.0),
    ("episodes", "props", 0.0),
)
"""Keys that are left out at their default, so that hashes of older sequences stay valid."""


def resolve_config(scene: Scene, rig: Rig) -> dict[str, Any]:
    """Collect all that the content of a sequence depends on. Files appear as name and checksum.

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
            config[table][key] = {"name": Path(path).name, "sha256": sha256(Path(path))}
    if folder := config["place"].pop("textures", None):
        from egocap_sim.environment.texture_folder import picture_files

        config["place"]["textures"] = {p.name: sha256(p) for p in picture_files(Path(folder))}
    return config
