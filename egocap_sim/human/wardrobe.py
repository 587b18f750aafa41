"""Make a whole person from a seed: shape, skin, hair, clothes and headgear."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from egocap_sim.human.anny_model import anatomy, bare_body, landmarks
from egocap_sim.human.person import Person
from egocap_sim.human.phenotype import Phenotype
from egocap_sim.human.skin import IRISES, skin_mesh, skin_texture
from egocap_sim.mesh import Actor


def make_person(
    seed: int,
    *,
    height_m: float | None = None,
    age_years: float | None = None,
    phenotype: Mapping[str, float] | None = None,
    outfit: Mapping[str, str] | None = None,
    headgear: str | None = None,
    name: str = "person",
) -> Person:
    """Make the person of a seed."""
    rng = np.random.default_rng([seed, 0])
    body = bare_body(Phenotype(gender=float(rng.uniform())), height_m or rng.uniform(1.55, 1.9))
    texture = skin_texture(rng.uniform(), np.array([0.2, 0.12, 0.08]), IRISES[0], rng)
    skin = skin_mesh(body, texture, np.zeros(len(body.vertices), bool))
    return Person(
        name=name,
        height_m=body.height_m,
        mass_kg=body.volume_m3 * 1000,
        joints=body.joints,
        landmarks=landmarks(body),
        body_vertices=body.vertices,
        body_owner=anatomy().owner,
        actor=Actor(name, (skin,)),
        description={"seed": seed},
    )
