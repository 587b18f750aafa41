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
    """The rig at the recorded image size; a sampled one is drawn from the scene's seed."""
    if table.name == SAMPLED:
        rig = sample_rig(make_rng(seed, "rig"), table.family or "arms")
    else:
        rig = load_rig(Path(table.file) if table.file else rig_file(table.name or DEFAULT_RIG))
    return rig.resized(*table.size) if table.size else rig


def resolve_headgear(table: RigTable, rig: Rig, seed: int) -> str:
    """The rig's carrier, a value of `[person] headgear`; of a sampled rig, drawn from the seed."""
    if table.name == SAMPLED:
        return headgear_for(rig, make_rng(seed, "headgear"), table.family or "arms")
    return _HEADGEAR.get(rig.name, "helmet")
