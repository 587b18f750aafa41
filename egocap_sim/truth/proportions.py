"""A simulated person's proportions on the tracker's skeleton.

The skeletons differ on purpose: the simulated trunk bends at two joints below the chest, the
tracker's at one, and simulated ball joints correspond to hinges of the tracker.
"""

from __future__ import annotations

from egocap.body.proportions import Proportions
from egocap_sim.core.bodies import INDEX, LABEL_BODY
from egocap_sim.human.body.person import Person

LOWER_SPINE_SHARE = 0.5
"""Where the tracker's lower spine bends: 0 at the simulated chest joint, 1 at the spine joint."""

_SIDE_JOINTS = {
    "clavicle": "clavicle", "shoulder": "upperarm", "elbow": "forearm", "wrist": "hand",
    "hip": "thigh", "knee": "calf", "ankle": "foot",
}  # fmt: skip


def measure_proportions(person: Person) -> Proportions:
    """Measure a person at rest; the head frame's origin is the simulated head joint.

    Raises InputError for bone lengths outside the human range.
    """
    joint = {name: person.joints[i] - person.joints[INDEX["head"]] for name, i in INDEX.items()}
    points = {
        "neck": joint["head"],
        "upper_spine": joint["neck"],
        "lower_spine": (
            (1 - LOWER_SPINE_SHARE) * joint["chest"] + LOWER_SPINE_SHARE * joint["spine"]
        ),
    }
    for side, prefix in (("left_", "l_"), ("right_", "r_")):
        points |= {side + name: joint[prefix + body] for name, body in _SIDE_JOINTS.items()}
    for end in ("head", "left_hand", "right_hand", "left_foot", "right_foot"):
        points[end] = joint[LABEL_BODY[end]] + person.landmarks[end]
    return Proportions.from_rest_joints(points)
