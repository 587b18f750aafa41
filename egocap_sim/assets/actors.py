"""Who and what else moves in a scene, beside the wearer."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Actor


@dataclass(frozen=True, eq=False)
class Extra:
    """An actor and its pose in every frame: another person, a ball, a bicycle.

    `skinning` maps its rest pose to the world, body by body, at the cameras' frame times. `joints`
    are a person's (axis J as `egocap.body.labels.LABELS`, world, metres); None of a thing.
    """

    actor: Actor
    skinning: Float[Array, "T B 4 4"]
    joints: Float[Array, "T 18 3"] | None = None
