"""Write a calibrated rig: TOML for people, JSON with the same digits for programs."""

from __future__ import annotations

import json
from pathlib import Path

from egocap.cameras.rig import Mount, Rig
from egocap.errors import InputError
from egocap.files import write_atomically

FORMATS = (".toml", ".json")


def check_rig_name(path: Path) -> None:
    """Raise InputError unless a rig can be written under this name."""
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"cannot write the rig '{path.name}'",
                         valid="a name that ends in .toml or .json")  # fmt: skip


def write_rig(path: Path, rig: Rig, notes: tuple[str, ...] = ()) -> None:
    """Write a rig with all digits. `notes` stand at the top of a TOML file.

    Raises as `check_rig_name` and `egocap.files.disk_errors`.
    """
    check_rig_name(path)
    if path.suffix.lower() == ".json":
        rig.to_json(path)
        return
    head = [f"# {line}" for line in notes]
    head += [f"name = {json.dumps(rig.name)}", f"frame_rate = {rig.frame_rate!r}"]
    tables = [line for mount in rig.mounts for line in _camera_table(mount)]
    write_atomically(path, "\n".join([*head, *tables]) + "\n")


def _camera_table(mount: Mount) -> list[str]:
    T = mount.T_head_camera
    lens = mount.camera.to_dict()
    lines = ["", "[[cameras]]", f'name = "{mount.name}"',
             f"position = {T[:3, 3].tolist()}  # metres, head frame: forward, left, up",
             f"rotation = {T[:3, :3].tolist()}  # columns: the camera's right, down and forward",
             "", "[cameras.lens]"]  # fmt: skip
    return lines + [f"{key} = {json.dumps(value)}" for key, value in lens.items()]
