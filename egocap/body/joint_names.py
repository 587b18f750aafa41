"""Joint names of other data sets, and the joint sets over which errors are averaged.

A name maps to the label at its centre of rotation ("hand_l" of UnrealEgo is the wrist). Data sets
differ most in the point of the skull that is called head.

Source: the data sets' own code and documents; the paper, section 5.4 (17 joints).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from egocap.body.labels import EVALUATED, LABEL_INDEX, LABELS
from egocap.errors import InputError


def _both(right: str, left: str, template: str, parts: Mapping[str, str]) -> dict[str, str]:
    """Map names of both sides (`template` with {side} and {part}) to labels."""
    return {
        template.format(side=side, part=theirs): f"{ours_side}_{ours}"
        for side, ours_side in ((left, "left"), (right, "right"))
        for theirs, ours in parts.items()
    }


_LIMBS = {"Arm": "shoulder", "ForeArm": "elbow", "Hand": "wrist",
          "UpLeg": "hip", "Leg": "knee", "Foot": "ankle"}  # fmt: skip

DATASET_NAMES: Mapping[str, Mapping[str, str]] = {
    "egocap": {label: label for label in LABELS},
    "unrealego": {
        "head": "head",
        "neck_01": "neck",
        **_both("r", "l", "{part}_{side}", {
            "upperarm": "shoulder", "lowerarm": "elbow", "hand": "wrist",
            "thigh": "hip", "calf": "knee", "foot": "ankle", "ball": "foot",
        }),
    },
    "ego4view": {"Head": "head", "Neck": "neck",
                 **_both("Right", "Left", "{side}{part}", {**_LIMBS, "ToeBase": "foot"})},
    "mo2cap2": {"Neck": "neck",
                **_both("Right", "Left", "{side}{part}", {**_LIMBS, "Toe": "foot"})},
    "egobody3m": {
        "b_head": "head",
        "b_neck0": "neck",
        **_both("r", "l", "b_{side}_{part}", {
            "arm": "shoulder", "forearm": "elbow", "wrist": "wrist", "upleg": "hip", "leg": "knee",
            "talocrural": "ankle", "transversetarsal": "foot",
        }),
    },
    "renderpeople": {
        "head": "head",
        "neck": "neck",
        **_both("r", "l", "{part}_{side}", {
            "upperarm": "shoulder", "lowerarm": "elbow", "hand": "wrist", "middle_01": "hand",
            "upperleg": "hip", "lowerleg": "knee", "foot": "ankle", "ball": "foot",
        }),
    },
}  # fmt: skip
"""Data set -> its joint name -> label. UnrealEgo2 uses UnrealEgo's names; UnrealEgo-RW, EgoRear and
xR-EgoPose use Ego4View's; SceneEgo and EgoPW use Mo2Cap2's, and so do EgoWholeMocap's body joints,
whose skeleton with fingers is RenderPeople's. EgoBody3M has the middle of the foot, not its ball,
and RenderPeople's first joint of the middle finger is the hand's knuckles."""

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")

JOINT_ORDER: Mapping[str, tuple[str, ...]] = {
    "egocap": LABELS,
    "unrealego": ("head", "neck_01", *(
        f"{part}_{side}"
        for part in ("upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball")
        for side in "lr")),
    "ego4view": ("Head", "Neck", *(
        f"{side}{part}" for part in (*_LIMBS, "ToeBase") for side in ("Left", "Right"))),
    "mo2cap2": ("Neck", *(
        f"{side}{part}"
        for parts in (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot", "Toe"))
        for side in (("Right", "Left")) for part in parts)),
    "egobody3m": (
        "b_head", "b_l_shoulder", "b_l_arm", "b_l_forearm", "b_l_wrist",
        "b_r_shoulder", "b_r_arm", "b_r_forearm", "b_r_wrist",
        "b_neck0", "b_spine0", "b_spine1", "b_spine2", "b_spine3",
        *(f"b_{side}_{part}" for side in "rl" for part in
          ("upleg", "leg", "foot_twist", "talocrural", "subtalar", "transversetarsal"))),
    "renderpeople": (
        "hip", "upperleg_l", "upperleg_r", "spine_01", "lowerleg_l", "lowerleg_r", "spine_02",
        "foot_l", "foot_r", "spine_03", "ball_l", "ball_r", "foot_end_l", "foot_end_r", "neck",
        "shoulder_l", "shoulder_r", "head", "upperarm_l", "upperarm_r", "lowerarm_l", "lowerarm_r",
        "hand_l", "hand_r", "head_end", "jaw", "jaw_end", "eye_l", "eye_end_l", "eye_r",
        "eye_end_r", "mouth_l", "mouth_r",
        *(f"{finger}_{part}_{side}" for side in "lr" for finger in _FINGERS
          for part in ("01", "02", "03", "end"))),
}  # fmt: skip
"""Data set -> all its joints, in the order of its arrays."""


def _label_indices(dataset: str) -> tuple[int, ...]:
    return tuple(sorted(LABEL_INDEX[label] for label in DATASET_NAMES[dataset].values()))


JOINT_SETS: Mapping[str, tuple[int, ...]] = {
    "egocap-17": EVALUATED,
    "egocap-18": tuple(range(len(LABELS))),
    "unrealego-16": _label_indices("unrealego"),
    "mo2cap2-15": _label_indices("mo2cap2"),
}
"""Joints over which errors are averaged: EgoCap's without the head; all labels; UnrealEgo's (also
Ego4View's: no finger tips); Mo2Cap2's (also SceneEgo's and EgoPW's: no head, no finger tips)."""


def match_labels(names: Sequence[str], dataset: str = "egocap") -> dict[int, int]:
    """Map positions in `names` to label indices; names without a label are omitted.

    Case, spaces and underscores are ignored.

    Raises:
        InputError: an unknown data set; a joint named twice; no known name, or more names known in
            another data set.
    """
    if dataset not in DATASET_NAMES:
        raise InputError(f"no joint names of '{dataset}'", valid=DATASET_NAMES)
    table = {_key(theirs): LABEL_INDEX[ours] for theirs, ours in DATASET_NAMES[dataset].items()}
    found: dict[int, int] = {}
    for i, name in enumerate(names):
        if (label := table.get(_key(name))) is None:
            continue
        if label in found.values():
            raise InputError(f"joint '{name}' occurs twice")
        found[i] = label
    if len(found) < (most := max(_known(names, other) for other in DATASET_NAMES)) or not most:
        others = [d for d in DATASET_NAMES if most and _known(names, d) == most]
        theirs = f"; {most} of them are names of {' or '.join(others)}" if others else ""
        raise InputError(
            f"{len(found)} of {len(names)} names are joints of {dataset}{theirs}: "
            f"{', '.join(names)}",
            valid=DATASET_NAMES[dataset],
        )
    return found


def _known(names: Sequence[str], dataset: str) -> int:
    """Number of names that the data set has."""
    return len({_key(name) for name in names} & {_key(name) for name in DATASET_NAMES[dataset]})


def _key(name: str) -> str:
    return name.lower().replace("_", "").replace(" ", "")
