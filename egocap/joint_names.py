"""Other data sets' joint names for the labels, and the joint sets that errors are averaged over.

The one table: readers of data sets, prediction files and protocols all use it. A name means the
centre of rotation that its data set puts there ("hand_l" of UnrealEgo turns about the wrist). Heads
differ most: a label there is a point of the skull, and no two data sets choose the same one.

Source: the data sets' own code and documents; the paper, section 5.4 (17 joints).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from egocap.errors import InputError
from egocap.labels import EVALUATED, LABEL_INDEX, LABELS


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
        InputError: no such data set; a joint named twice; or not one name is known, with the
            data sets whose names these are, if any.
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
    if not found:
        raise InputError(
            f"no joint of {dataset} among {', '.join(names)}"
            + _whose(names, but=dataset),
            valid=DATASET_NAMES[dataset],
        )  # fmt: skip
    return found


def _whose(names: Sequence[str], but: str) -> str:
    keys = {_key(name) for name in names}
    others = [d for d, table in DATASET_NAMES.items()
              if d != but and len(keys & {_key(n) for n in table}) >= len(table) // 2]  # fmt: skip
    return f"; they are the names of {' or '.join(others)}" if others else ""


def _key(name: str) -> str:
    return name.lower().replace("_", "").replace(" ", "")
