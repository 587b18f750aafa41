"""What a refinement changed and what bears the weight, as numbers and as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from egocap.files import write_npz
from egocap_sim.refinement.humanoid import SUPPORTS
from egocap_sim.refinement.refine import Refinement

PARTS = ("feet", "seat", "knees", "hands")
"""Of `SUPPORTS`: four, then two each."""
_QUANTITIES = ("moved_mm", "moved_95_mm", "residual_before", "residual_before_95", "residual",
               "residual_95", *PARTS)  # fmt: skip


def summary(found: Refinement) -> dict[str, float | None]:
    """What a refinement changed, over the refined frames; None where there are none.

    Distances are mm, forces body weights; feet, seat, knees and hands: share of the upward force.
    """
    own = found.refined
    result: dict[str, float | None] = {"frames": len(own), "refined": int(own.sum()),
                                "mass_kg": found.mass_kg}  # fmt: skip
    if not own.any():
        return result | dict.fromkeys(_QUANTITIES)
    moved = 1000 * found.moved[own]
    result |= {"moved_mm": float(moved.mean()), "moved_95_mm": float(np.percentile(moved, 95))}
    for name, wrench in (("residual_before", found.residual_before), ("residual", found.residual)):
        force = np.linalg.norm(wrench[own, :3], axis=1) / found.weight
        result |= {name: float(np.median(force)), f"{name}_95": float(np.percentile(force, 95))}
    up = found.support[own, :, 2].mean(0)
    parts = np.split(up, (4, 6, 8))
    return result | {name: float(part.sum() / max(up.sum(), 1e-9))
                     for name, part in zip(PARTS, parts, strict=True)}  # fmt: skip


def save_forces(path: Path, found: Refinement) -> None:
    """Write the forces as npz: newtons, world axes. Raises as `egocap.files.disk_errors`."""
    write_npz(
        path, time=found.track.times, support=found.support, support_names=np.array(SUPPORTS),
        residual=found.residual, residual_before=found.residual_before, refined=found.refined,
        mass_kg=np.array(found.mass_kg),
    )  # fmt: skip
