"""Resolve a scene's rig table to a rig and the headgear that carries it."""

from __future__ import annotations

from pathlib import Path

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap_sim.core.resources import SAMPLED, rig_file
from egocap_sim.core.rng import make_rng
from egocap_sim.scene.config import RigTable
from egocap_sim.scene.rig_sampler import headgear_for, sample_rig

DEFAULT_RIG = "egorig1"
# Of the built-in rigs.
_HEADGEAR = {
    "egorig1": "helmet", "egorig2": "headset", "glasses": "glasses", "headset4": "headset",
    "cap": "cap",
}  # fmt: skip


def resolve_rig(table: RigTable, seed: int) -> Rig:
    """The rig at the recorded image size; a sampled one is drawn from the scene's seed.

    The images of a family have shapes of their own: they are scaled down to fit into that size.
    """
    if table.name == SAMPLED:
        rig = sample_rig(make_rng(seed, "rig"), table.family or "arms")
    else:
        rig = load_rig(Path(table.file) if table.file else rig_file(table.name or DEFAULT_RIG))
    if table.size and table.family:
        return _fitted(rig, table.size)
    return rig.resized(*table.size) if table.size else rig


def _fitted(rig: Rig, size: tuple[int, int]) -> Rig:
    """The rig with images scaled down, in proportion, to fit into width x height pixels."""
    width, height = rig.cameras[0].width, rig.cameras[0].height
    scale = min(size[0] / width, size[1] / height, 1.0)
    return rig.resized(round(width * scale), round(height * scale))


def resolve_headgear(table: RigTable, rig: Rig, seed: int) -> str:
    """The rig's carrier, a value of `[person] headgear`; of a sampled rig, drawn from the seed."""
    if table.name == SAMPLED:
        return headgear_for(rig, make_rng(seed, "headgear"), table.family or "arms")
    return _HEADGEAR.get(rig.name, "helmet")
