"""Other data sets' joint names for the labels, and the joint sets that errors are averaged over.

The one table: readers of data sets, prediction files and protocols all use it. A name means the
centre of rotation that its data set puts there ("hand_l" of UnrealEgo turns about the wrist). Heads
differ most: a label there is a point of the skull, and no two data sets choose the same one.

Source: the data sets' own code and documents; the paper, section 5.4 (17 joints).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from egocap.body.labels import EVALUATED, LABEL_INDEX, LABELS
from egocap.errors import InputError


def _both(right: str, left: str, template: str, parts: Mapping[str, str]) -> dict[str, str]:
    """Names of both sides: theirs (`template` with {side} and {part}) -> ours."""
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
}  # fmt: skip
"""Data set -> its joint name -> our label. UnrealEgo2 and -RW use UnrealEgo's names; EgoRear uses
Ego4View's; SceneEgo, EgoPW and EgoWholeMocap use Mo2Cap2's."""


def _labels_of(dataset: str) -> tuple[int, ...]:
    return tuple(sorted(LABEL_INDEX[label] for label in DATASET_NAMES[dataset].values()))


JOINT_SETS: Mapping[str, tuple[int, ...]] = {
    "egocap-17": EVALUATED,
    "egocap-18": tuple(range(len(LABELS))),
    "unrealego-16": _labels_of("unrealego"),
    "mo2cap2-15": _labels_of("mo2cap2"),
}
"""Joints whose errors are averaged: EgoCap's without the head; all labels; UnrealEgo's (also
Ego4View's: no finger tips); Mo2Cap2's (also SceneEgo's and EgoPW's: no head, no finger tips)."""


def label_of(names: Sequence[str], dataset: str = "egocap") -> dict[int, int]:
    """Position in `names` -> index of the label; names that stand for no label are left out.

    Case and a missing underscore do not matter.

    Raises:
        InputError: no such data set; a joint named twice; not one name is known, or another data
            set knows more of them.
    """
    if dataset not in DATASET_NAMES:
        raise InputError(f"no joint names of '{dataset}'", valid=DATASET_NAMES)
    table = {_key(theirs): LABEL_INDEX[ours] for theirs, ours in DATASET_NAMES[dataset].items()}
    found: dict[int, int] = {}
    for i, name in enumerate(names):
        if (label := table.get(_key(name))) is None:
            continue
        if label in found.values():
            raise InputError(f"joint '{name}' is there twice")
        found[i] = label
    if len(found) < (most := max(_known(names, other) for other in DATASET_NAMES)) or not most:
        others = [d for d in DATASET_NAMES if most and _known(names, d) == most]
        theirs = f"; {most} of them are names of {' or '.join(others)}" if others else ""
        raise InputError(
            f"{len(found)} of the names {', '.join(names)} are joints of {dataset}{theirs}",
            valid=DATASET_NAMES[dataset],
        )
    return found


def _known(names: Sequence[str], dataset: str) -> int:
    """How many of the names the data set has."""
    return len({_key(name) for name in names} & {_key(name) for name in DATASET_NAMES[dataset]})


def _key(name: str) -> str:
    return name.lower().replace("_", "").replace(" ", "")
