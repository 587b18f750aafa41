"""The detection labels: names, order, mirror pairs and joint groups."""

from __future__ import annotations

LABELS: tuple[str, ...] = (
    "head", "neck",
    "left_shoulder", "left_elbow", "left_wrist", "left_hand",
    "right_shoulder", "right_elbow", "right_wrist", "right_hand",
    "left_hip", "left_knee", "left_ankle", "left_foot",
    "right_hip", "right_knee", "right_ankle", "right_foot",
)  # fmt: skip

LABEL_INDEX: dict[str, int] = {name: i for i, name in enumerate(LABELS)}

EVALUATED: tuple[int, ...] = tuple(range(1, 18))
"""The 17 joints of 3-D errors: every label but the head."""

UPPER: tuple[int, ...] = tuple(i for i in EVALUATED if LABELS[i].split("_")[-1] in
                               ("neck", "shoulder", "elbow", "wrist", "hand"))  # fmt: skip
LOWER: tuple[int, ...] = tuple(i for i in EVALUATED if i not in UPPER)


def other_side(name: str) -> str:
    """Swap left and right in a name, e.g. 'left_elbow' -> 'right_elbow'."""
    return name.replace("left_", "?").replace("right_", "left_").replace("?", "right_")


MIRROR: tuple[int, ...] = tuple(LABEL_INDEX[other_side(name)] for name in LABELS)
"""Index of each label's counterpart on the other side of the body."""

LIMBS: tuple[tuple[int, int], ...] = tuple(
    (LABEL_INDEX[a], LABEL_INDEX[b])
    for a, b in [("head", "neck")] + [
        (s + a, s + b)
        for s in ("left_", "right_")
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"),
                     ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"), ("shoulder", "hip"))
    ] + [("neck", "left_shoulder"), ("neck", "right_shoulder"), ("left_hip", "right_hip")]
)  # fmt: skip
"""Pairs of labels joined by a line in drawings."""


def without_side(name: str) -> str:
    """Remove the side from a name, e.g. 'left_elbow' -> 'elbow'."""
    return name.removeprefix("left_").removeprefix("right_")
