"""Which joints each view sees, and what hides the others, from what the renderer drew.

A joint lies inside the body, so it counts as seen when the surface its ray first meets is the skin
or cloth right around it: a part next to the joint, no farther in front than the tissue is deep.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.labels import LABELS
from egocap.sequence import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap_sim.bodies import BODIES, LABEL_BODY, PARENT
from egocap_sim.human.person import Person
from egocap_sim.parts import RIG, WEARER_FIRST, WEARER_LAST, wearer_part
from egocap_sim.render.views import Views

TISSUE_M = {
    "head": 0.14, "neck": 0.10, "shoulder": 0.10, "elbow": 0.07, "wrist": 0.05, "hand": 0.05,
    "hip": 0.17, "knee": 0.09, "ankle": 0.08, "foot": 0.07,
}  # fmt: skip
"""How deep each kind of joint may lie under skin along a ray, metres, for a person of 1.75 m: half
the breadth of a heavy adult there. Our estimate, generous: another limb is told by its part."""
CLOTH_M = 0.04  # how far loose cloth stands off the skin
_STATURE_M = 1.75


def joint_visibility(
    views: Views,
    person: Person,
    joints_camera: Float[Array, "V 18 3"],
    joints_2d: Float[Array, "V 18 2"],
    in_view: Bool[Array, "V 18"],
) -> UInt8[Array, "V 18"]:
    """VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED or OCCLUDED (`egocap.sequence`) of every joint and view.

    The wearer's body, clothes and the rig occlude as self, everything else as others. A joint whose
    ray meets nothing, or a surface beyond it, is visible: it shows at the very edge of the body.
    """
    reach = person.height_m / _STATURE_M * np.array([TISSUE_M[_kind(n)] for n in LABELS]) + CLOTH_M
    result = np.full(in_view.shape, OUT_OF_VIEW, np.uint8)
    for v, seen in enumerate(in_view):
        joints = np.flatnonzero(seen)
        surface, part = views.surface_at(v, joints_2d[v, joints])
        depth = np.linalg.norm(joints_camera[v, joints], axis=-1)
        around = _AROUND[joints, part] & (surface >= depth - reach[joints])
        mine = (part >= WEARER_FIRST) & (part <= WEARER_LAST) | (part == RIG)
        hidden = np.where(mine, SELF_OCCLUDED, OCCLUDED)
        result[v, joints] = np.where(around | (surface >= depth), VISIBLE, hidden)
    return result


def _kind(label: str) -> str:
    return label.split("_")[-1]


def _parts_around() -> Bool[Array, "18 256"]:
    """For every label, the parts whose surface lies around it: its body, parent and children.

    The clavicle and neck are no wider than the joints at their ends, so what lies beyond them
    counts too.
    """
    neighbours = {body: {body} for body in BODIES}
    for child, parent in PARENT.items():
        neighbours[child].add(parent)
        neighbours[parent].add(child)
    slim = {"neck", "l_clavicle", "r_clavicle"}
    table = np.zeros((len(LABELS), 256), bool)
    for j, label in enumerate(LABELS):
        near = neighbours[LABEL_BODY[label]]
        for body in near | set().union(*(neighbours[b] for b in near & slim)):
            table[j, wearer_part(body)] = True
    return table


_AROUND = _parts_around()
