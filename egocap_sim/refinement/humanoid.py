"""The tracker's skeleton as a MuJoCo model: a free head, 37 hinges, points that may bear weight.

A pose of the model is the head's position and quaternion in the world, then the 37 angles of
`egocap.body.skeleton` about its axes, in the order of `HINGES`. The Gaussians of an average body
distribute the mass of every segment, which are shares as in `egocap_sim.physics.model`.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.gaussians import RADIUS_SIGMAS, SKULL, GaussianBody
from egocap.body.labels import without_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_INDEX, JOINTS, POINT_INDEX, Joint
from egocap.data.track import CONTACTS
from egocap.errors import InputError
from egocap.geometry import GRAVITY
from egocap_sim.physics.model import MASS_SHARE

SUPPORTS: tuple[str, ...] = (
    *CONTACTS, *(f"{side}_{part}" for part in ("hip", "knee", "hand") for side in ("left", "right"))
)  # fmt: skip
"""What may bear weight: heels and toes, then the seat (at the hip joints), knees and hands."""
HEEL_SHARE = 0.3
"""Distance of the heel behind the ankle, as a share of the toe's before it: the tracker's."""
_HALF_WIDTH_M = 0.03  # of a sole: each heel and toe bears at two points
SITE_SUPPORT: Int[Array, "14"] = np.repeat(
    np.arange(len(SUPPORTS)), [2 if name in CONTACTS else 1 for name in SUPPORTS]
)
"""The support of each of the model's sites, which are named by their place here."""

_ARMATURE = 0.01  # kg m^2 on every hinge: keeps light segments stable
_HALF_TRUNK = MASS_SHARE["spine"] / 2
_SHARES: dict[str, float] = {
    "head": MASS_SHARE["head"], "neck": MASS_SHARE["neck"],
    "upper_spine": MASS_SHARE["chest"] + _HALF_TRUNK,
    "lower_spine": MASS_SHARE["pelvis"] + _HALF_TRUNK, "clavicle": MASS_SHARE["clavicle"],
    "shoulder": MASS_SHARE["upperarm"], "elbow": MASS_SHARE["forearm"],
    "wrist": MASS_SHARE["hand"], "hip": MASS_SHARE["thigh"], "knee": MASS_SHARE["calf"],
    "ankle": MASS_SHARE["foot"] + MASS_SHARE["toe"],
}  # fmt: skip
"""Share of the mass in the segment that moves with each joint, before normalisation."""


def build_humanoid(proportions: Proportions, mass_kg: float) -> mujoco.MjModel:
    """Compile the model of a person. Raises InputError for an implausible mass."""
    if not 20.0 <= mass_kg <= 250.0:
        raise InputError(f"a mass of {mass_kg:g} kg", valid="20 to 250")
    shapes = _shapes(proportions, mass_kg)
    return mujoco.MjModel.from_xml_string(f"""<mujoco model="wearer">
  <compiler angle="radian"/>
  <option gravity="{_text(GRAVITY)}" integrator="implicitfast"><flag autoreset="disable"/></option>
  <default>
    <joint type="hinge" armature="{_ARMATURE}"/>
    <geom type="sphere" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="head"><freejoint/>{shapes["head"]}{_below(None, proportions, shapes)}</body>
  </worldbody>
</mujoco>""")


def _below(parent: str | None, proportions: Proportions, shapes: dict[str, str]) -> str:
    """The bodies that hang on a segment (None: the skull) as MJCF text."""
    found = ""
    for joint in _carried(parent):
        hinges = "".join(f'<joint name="{d.name}" axis="{_text(d.axis)}"/>' for d in joint.dofs)
        place = _text(proportions.offsets[POINT_INDEX[joint.name]])
        found += (f'<body name="{joint.name}" pos="{place}">{hinges}{shapes[joint.name]}'
                  f"{_below(joint.name, proportions, shapes)}</body>")  # fmt: skip
    return found


def _carried(parent: str | None) -> list[Joint]:
    return [joint for joint in JOINTS if joint.parent == parent]


def _depth_first(parent: str | None) -> Iterator[int]:
    for joint in _carried(parent):
        yield from (DOF_INDEX[dof.name] for dof in joint.dofs)
        yield from _depth_first(joint.name)


HINGES: Int[Array, "37"] = np.array([*_depth_first(None)])
"""The angle of every hinge: MuJoCo orders them depth first."""


def _shapes(proportions: Proportions, mass_kg: float) -> dict[str, str]:
    """Spheres with mass, and sites that may bear weight, of every segment as MJCF text."""
    body = GaussianBody.from_proportions(proportions)
    names = {SKULL: "head"} | {i: joint.name for i, joint in enumerate(JOINTS)}
    shares = {name: _SHARES[without_side(name)] for name in names.values()}
    whole = sum(shares.values())
    shapes = {}
    for carrier, name in names.items():
        own = np.flatnonzero(body.joint == carrier)
        volume = body.sigma[own] ** 3
        masses = mass_kg * shares[name] / whole * volume / volume.sum()
        shapes[name] = "".join(
            f'<geom size="{_text(RADIUS_SIGMAS * body.sigma[g, None])}" '
            f'pos="{_text(body.offset[g])}" mass="{_text([mass])}"/>'
            for g, mass in zip(own, masses, strict=True)
        )
    for i, (segment, place) in enumerate(_sites(proportions)):
        shapes[segment] += f'<site name="{i}" pos="{_text(place)}"/>'
    return shapes


def _sites(proportions: Proportions) -> Iterator[tuple[str, Float[Array, "3"]]]:
    """Segment and place on it of every site: two for a heel or toe, one for other supports."""
    for name in SUPPORTS:
        side, part = name.split("_")
        if name not in CONTACTS:
            hand = part == "hand"
            place = proportions.offsets[POINT_INDEX[name]] if hand else np.zeros(3)
            yield f"{side}_{'wrist' if hand else part}", place
            continue
        toe = proportions.offsets[POINT_INDEX[f"{side}_foot"]]
        across = np.array([-toe[1], toe[0], 0.0]) / np.linalg.norm(toe[:2])
        place = toe * [-HEEL_SHARE, -HEEL_SHARE, 1.0] if part == "heel" else toe
        for sign in (1.0, -1.0):
            yield f"{side}_ankle", place + sign * _HALF_WIDTH_M * across


def _text(values: Float[Array, "n"] | tuple[float, ...] | list[float]) -> str:
    """Numbers as MJCF text, exact."""
    return " ".join(repr(float(v)) for v in values)
