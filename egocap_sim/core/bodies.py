"""The simulated person's rigid bodies: names, tree, and where the detection labels sit on them.

At rest every body frame is parallel to the world's axes (the person stands facing +x) and has its
origin at the joint that connects the body to its parent.
"""

from __future__ import annotations

BODIES: tuple[str, ...] = (
    "pelvis", "spine", "chest", "neck", "head",
    "l_clavicle", "l_upperarm", "l_forearm", "l_hand",
    "r_clavicle", "r_upperarm", "r_forearm", "r_hand",
    "l_thigh", "l_calf", "l_foot", "l_toe",
    "r_thigh", "r_calf", "r_foot", "r_toe",
)  # fmt: skip

PARENT: dict[str, str] = {"spine": "pelvis", "chest": "spine", "neck": "chest", "head": "neck"}
for _s in ("l_", "r_"):
    PARENT |= {
        _s + "clavicle": "chest", _s + "upperarm": _s + "clavicle",
        _s + "forearm": _s + "upperarm", _s + "hand": _s + "forearm",
        _s + "thigh": "pelvis", _s + "calf": _s + "thigh",
        _s + "foot": _s + "calf", _s + "toe": _s + "foot",
    }  # fmt: skip

INDEX: dict[str, int] = {name: i for i, name in enumerate(BODIES)}
PARENTS: tuple[int, ...] = tuple(INDEX[PARENT[b]] if b in PARENT else -1 for b in BODIES)

FEET: tuple[str, ...] = ("l_foot", "l_toe", "r_foot", "r_toe")  # the axis of contact arrays

LABEL_BODY: dict[str, str] = {"head": "head", "neck": "neck"}
"""Body each detection label is fixed to; Person.landmarks gives the offset in the body's frame."""
for _side, _s in (("left", "l_"), ("right", "r_")):
    LABEL_BODY |= {
        f"{_side}_shoulder": _s + "upperarm", f"{_side}_elbow": _s + "forearm",
        f"{_side}_wrist": _s + "hand", f"{_side}_hand": _s + "hand",
        f"{_side}_hip": _s + "thigh", f"{_side}_knee": _s + "calf",
        f"{_side}_ankle": _s + "foot", f"{_side}_foot": _s + "toe",
    }  # fmt: skip
