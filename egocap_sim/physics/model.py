"""The person as a MuJoCo model: 21 bodies, a free root, 20 ball joints, feet that touch the floor.

Masses are shares of the person's mass; shapes are fitted to the skin of each body, so that inertias
are individual. Body i + 1 of the model is `core.bodies.BODIES[i]`, its frame parallel to
the world at rest.

Source: segment masses (mean of women and men) and the cut of the trunk from P. de Leva,
"Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters", J. Biomechanics 29 (1996),
table 4; the split within head + neck, upper trunk + clavicles and foot + toes is our estimate.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import GRAVITY
from egocap_sim.core.bodies import BODIES, FEET, INDEX, PARENT
from egocap_sim.core.ground_boxes import GroundBox
from egocap_sim.human.body.person import Person
from egocap_sim.human.body.soles import Sole, soles

MASS_SHARE: dict[str, float] = {
    "pelvis": 0.1182, "spine": 0.1549, "chest": 0.1210, "neck": 0.0110, "head": 0.0571,
    "clavicle": 0.0180, "upperarm": 0.0263, "forearm": 0.0150, "hand": 0.0059,
    "thigh": 0.1447, "calf": 0.0457, "foot": 0.0109, "toe": 0.0024,
}  # fmt: skip
"""Share of the body mass in one segment, before normalisation."""

_LIMBS = {"neck": "head", "clavicle": "upperarm", "upperarm": "forearm", "forearm": "hand",
          "thigh": "calf", "calf": "foot"}  # fmt: skip
_ARMATURE = 0.08  # kg m^2 on every ball joint: keeps light segments stable at 4 ms
_DAMPING = 1.0  # N m s/rad
FRICTION = 1.0
_GIVE = 0.002  # metres by which soles are thicker than the skin
FLOOR = "floor"
_GROUND = 'contype="1" friction="0.01 0.01 0.001"'  # the geoms of the feet set the friction


def segment(body: str) -> str:
    """Name of a body without its side."""
    return body.split("_")[-1]


def segment_masses(person: Person) -> Float[Array, "21"]:
    """Mass of each body in kg; they sum to the person's."""
    share = np.array([MASS_SHARE[segment(body)] for body in BODIES])
    return person.mass_kg * share / share.sum()


def build_model(
    person: Person, timestep_s: float, ground_boxes: Sequence[GroundBox] = ()
) -> mujoco.MjModel:
    """Compile the person's model, on a floor with boxes to stand on.

    Raises InputError for an implausible mass or values that are not finite.
    """
    if not 20.0 <= person.mass_kg <= 250.0:
        raise InputError(f"person '{person.name}' weighs {person.mass_kg:g} kg", valid="20 to 250")
    if not (np.isfinite(person.joints).all() and np.isfinite(person.body_vertices).all()):
        raise InputError(f"person '{person.name}' has joints or skin that are not finite numbers")
    return mujoco.MjModel.from_xml_string(mjcf(person, timestep_s, ground_boxes))


def mjcf(person: Person, timestep_s: float, ground_boxes: Sequence[GroundBox] = ()) -> str:
    """The model as MJCF text."""
    geoms = _geoms(person)
    raised = "".join(
        f'<geom type="box" pos="{_text(box.centre)}" size="{_text(box.size / 2)}" {_GROUND}/>'
        for box in ground_boxes
    )
    return f"""<mujoco model="person">
  <compiler angle="radian"/>
  <option timestep="{timestep_s!r}" gravity="{_text(GRAVITY)}" integrator="implicitfast"
          cone="elliptic" impratio="5"><flag autoreset="disable"/></option>
  <default>
    <joint type="ball" damping="{_DAMPING}" armature="{_ARMATURE}"/>
    <geom contype="0" conaffinity="0" friction="{FRICTION} 0.01 0.001" solref="0.01 1"/>
  </default>
  <worldbody>
    <geom name="{FLOOR}" type="plane" size="0 0 1" {_GROUND}/>{raised}
    {_body_xml("pelvis", person, geoms)}
  </worldbody>
</mujoco>"""


def _body_xml(body: str, person: Person, geoms: dict[str, str]) -> str:
    """A body, its joint and shape, and its children, depth first: the order of BODIES."""
    parent = PARENT.get(body)
    position = person.joints[INDEX[body]]
    if parent is None:
        joint = '<freejoint name="root"/>'
    else:
        position = position - person.joints[INDEX[parent]]
        joint = f'<joint name="{body}"/>'
    children = "".join(_body_xml(b, person, geoms) for b in BODIES if PARENT.get(b) == body)
    return f'<body name="{body}" pos="{_text(position)}">{joint}{geoms[body]}{children}</body>'


def _geoms(person: Person) -> dict[str, str]:
    """The shape of every body as MJCF text."""
    masses = segment_masses(person)
    boxes = {sole.body: sole for sole in soles(person)}
    geoms = {}
    for i, body in enumerate(BODIES):
        if body in FEET:
            shape = _box(boxes[body])
        elif segment(body) in _LIMBS:
            shape = _capsule(person, body)
        else:
            shape = _ellipsoid(person, body)
        geoms[body] = f'<geom name="{body}" mass="{float(masses[i])!r}" {shape}/>'
    return geoms


def _skin(person: Person, body: str) -> Float[Array, "N 3"]:
    """Vertices of a body, in its frame."""
    mine = person.body_owner.astype(int) == INDEX[body]
    return person.body_vertices[mine] - person.joints[INDEX[body]]


def _box(sole: Sole) -> str:
    # Soles are compliant by millimetres: thicker boxes let a foot held at z = 0 press on the floor.
    half = sole.half + [0.0, 0.0, _GIVE / 2]
    centre = sole.centre - [0.0, 0.0, _GIVE / 2]
    quaternion = (np.cos(sole.yaw / 2), 0.0, 0.0, np.sin(sole.yaw / 2))
    return (
        f'type="box" pos="{_text(centre)}" size="{_text(half)}" '
        f'quat="{_text(quaternion)}" conaffinity="1"'
    )


def _capsule(person: Person, body: str) -> str:
    """A capsule along the bone with the median radius of the skin."""
    follower = body.replace(segment(body), _LIMBS[segment(body)])
    end = person.joints[INDEX[follower]] - person.joints[INDEX[body]]
    skin, length = _skin(person, body), np.linalg.norm(end)
    radius = 0.04
    if len(skin) >= 10:
        away = skin - np.outer(skin @ end / length**2, end)
        radius = float(np.clip(np.median(np.linalg.norm(away, axis=1)), 0.02, 0.15))
    return f'type="capsule" fromto="0 0 0 {_text(end)}" size="{radius!r}"'


def _ellipsoid(person: Person, body: str) -> str:
    """An ellipsoid over the skin's extent."""
    skin, low, high = _skin(person, body), np.full(3, -0.05), np.full(3, 0.05)
    if len(skin) >= 10:
        low, high = np.percentile(skin, 2, axis=0), np.percentile(skin, 98, axis=0)
    half = np.clip((high - low) / 2, 0.02, 0.4)
    return f'type="ellipsoid" pos="{_text((low + high) / 2)}" size="{_text(half)}"'


def _text(values: object) -> str:
    """Numbers as MJCF text, exact."""
    return " ".join(repr(float(v)) for v in values)  # type: ignore[union-attr]
