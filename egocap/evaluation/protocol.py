"""Named protocols: which joints count, and what may be aligned before errors are measured.

A number without its protocol cannot be compared, so every report carries one and prints it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.joint_names import JOINT_SETS
from egocap.body.labels import LABEL_INDEX, LIMBS
from egocap.errors import InputError
from egocap.evaluation.alignment import (
    align_rigid,
    align_root,
    align_sequence,
    align_similarity,
    resize_bones,
)
from egocap.evaluation.metrics import bone_lengths

HIPS = (LABEL_INDEX["left_hip"], LABEL_INDEX["right_hip"])

UPPER_LIMBS = tuple(
    i
    for name, i in LABEL_INDEX.items()
    if name.split("_")[-1] in ("shoulder", "elbow", "wrist", "hand")
)
LOWER_LIMBS = tuple(
    i for name, i in LABEL_INDEX.items() if name.split("_")[-1] in ("hip", "knee", "ankle", "foot")
)
"""Upper and lower body as section 5.4 of the paper groups them: the neck is in neither."""

BONES = tuple((a, b) for a, b in LIMBS if {a, b} <= set(UPPER_LIMBS) or {a, b} <= set(LOWER_LIMBS))
"""The pairs of `LIMBS` that are rigid in a person: within an arm or a leg, and across the hips."""

TREE = (
    *((LABEL_INDEX["neck"], LABEL_INDEX[n]) for n in ("head", "left_shoulder", "right_shoulder")),
    *((LABEL_INDEX["neck"], LABEL_INDEX[n]) for n in ("left_hip", "right_hip")),
    *(
        (LABEL_INDEX[f"{side}_{a}"], LABEL_INDEX[f"{side}_{b}"])
        for side in ("left", "right")
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand"),
                     ("hip", "knee"), ("knee", "ankle"), ("ankle", "foot"))
    ),
)  # fmt: skip
"""(parent, child) from the neck outwards: the bones whose lengths are adjusted."""


@dataclass(frozen=True)
class AlignmentRule:
    """What may be moved before errors are measured. Joints: of the protocol's set, in its order."""

    suffix: str  # of the protocol's name
    words: str
    align: Callable[[Array, Array, Array | None, tuple[int, ...]], Array]
    needs: str = ""  # joints without which there is no such alignment, in words
    defined: Callable[[Array, tuple[int, ...]], bool] = lambda valid, joints: True


def _bone_adjusted(
    predicted: Array, truth: Array, mask: Array | None, joints: tuple[int, ...]
) -> Array:
    """Bones as long as the frame's true ones, then a similarity: what is left is directions.

    Source: BA-MPJPE of Wang et al., EgoWholeMocap, CVPR 2024, which brings both poses to a standard
    skeleton; here the truth stays as it is, so that a perfect pose has no error.
    """
    return align_similarity(_resized(predicted, truth, joints), truth, mask)


def _bones_then_rigid(
    predicted: Array, truth: Array, mask: Array | None, joints: tuple[int, ...]
) -> Array:
    """Bones as long as the frame's true ones, then a rotation and translation.

    Source: the evaluation of Xu et al., Mo2Cap2, IEEE VR 2019, which brings both poses to a
    standard skeleton.
    """
    return align_rigid(_resized(predicted, truth, joints), truth, mask)


def _resized(predicted: Array, truth: Array, joints: tuple[int, ...]) -> Array:
    """Predicted joints with every bone as long as the truth's in the same frame."""
    place = {joint: i for i, joint in enumerate(joints)}
    bones = tuple((place[a], place[b]) for a, b in TREE if a in place and b in place)
    return resize_bones(predicted, bone_lengths(truth, bones), bones)


def _mid_hip(predicted: Array, truth: Array, mask: Array | None, joints: tuple[int, ...]) -> Array:
    return align_root(predicted, truth, tuple(joints.index(j) for j in HIPS))


def _has_hips(valid: Array, joints: tuple[int, ...]) -> bool:
    return bool(valid[valid.any(1)][:, HIPS].all())


def _has_shape(valid: Array, joints: tuple[int, ...]) -> bool:
    """One or two joints have no shape of their own: an alignment would make them exact."""
    count = valid[:, joints].sum(1)
    return bool((count[count > 0] >= _LEAST_JOINTS).all())


def _has_bones(valid: Array, joints: tuple[int, ...]) -> bool:
    """A bone's length can be changed where both ends are known, up to the neck."""
    bones = [(a, b) for a, b in TREE if a in joints and b in joints]
    known = not any((valid[:, b] & ~valid[:, a]).any() for a, b in bones)
    return known and _has_shape(valid, joints)


_LEAST_JOINTS = 3
_HIPS_NEEDED = "both hips in every frame that has any joint"
_SHAPE_NEEDED = f"at least {_LEAST_JOINTS} joints in every frame that has any"
_BONES_NEEDED = f"{_SHAPE_NEEDED}, and with every joint all those between it and the neck"

ALIGNMENTS: Mapping[str, AlignmentRule] = {
    "none": AlignmentRule("", "no alignment", lambda p, t, m, j: p),
    "mid-hip": AlignmentRule(
        "-mid-hip", "mid-hips moved together", _mid_hip, _HIPS_NEEDED, _has_hips
    ),
    "rigid": AlignmentRule(
        "-rigid",
        "each frame rigidly aligned",
        lambda p, t, m, j: align_rigid(p, t, m),
        _SHAPE_NEEDED,
        _has_shape,
    ),
    "similarity": AlignmentRule(
        "-pa",
        "each frame aligned by a similarity (Procrustes with scale)",
        lambda p, t, m, j: align_similarity(p, t, m),
        _SHAPE_NEEDED,
        _has_shape,
    ),
    "sequence": AlignmentRule(
        "-sequence",
        "the whole sequence aligned by one similarity",
        lambda p, t, m, j: align_sequence(p, t, m),
    ),
    "sequence-rigid": AlignmentRule(
        "-sequence-rigid",
        "the whole sequence aligned by one rotation and translation",
        lambda p, t, m, j: align_sequence(p, t, m, scaled=False),
    ),
    "bone-adjusted": AlignmentRule(
        "-ba",
        "each frame's bones made as long as the true ones, then aligned by a similarity",
        _bone_adjusted,
        _BONES_NEEDED,
        _has_bones,
    ),
    "bones-then-rigid": AlignmentRule(
        "-ba-rigid",
        "each frame's bones made as long as the true ones, then rigidly aligned",
        _bones_then_rigid,
        _BONES_NEEDED,
        _has_bones,
    ),
}


@dataclass(frozen=True)
class Protocol:
    """How a 3-D error is measured: joints, frame and alignment, under a name to quote."""

    name: str
    joints: tuple[int, ...]  # indices into `egocap.body.labels.LABELS`
    alignment: str  # a key of `ALIGNMENTS`
    description: str

    def defined(self, counted: Bool[Array, "T 18"]) -> bool:
        """Whether this protocol can align poses of which these joints count."""
        return ALIGNMENTS[self.alignment].defined(counted, self.joints)

    def align(
        self,
        predicted: Float[Array, "T 18 3"],
        truth: Float[Array, "T 18 3"],
        valid: Bool[Array, "T 18"] | None = None,
    ) -> Float[Array, "T 18 3"]:
        """Predicted joints after this protocol's alignment to the true ones, head frame.

        Only the protocol's joints decide and move; the others are left where they were. `valid`
        tells which predicted joints exist (all, when None); the others are neither read nor made.
        """
        aligned, index = np.array(predicted, np.float64), list(self.joints)
        mask = None if valid is None else valid[:, index]
        rule = ALIGNMENTS[self.alignment].align
        aligned[:, index] = rule(aligned[:, index], truth[:, index], mask, self.joints)
        return aligned


_SET_WORDS = {
    "egocap-17": "17 joints without the head",
    "egocap-18": "all 18 labels",
    "unrealego-16": "16 joints with the head, without finger tips",
    "mo2cap2-15": "15 joints without head and finger tips",
}

PROTOCOLS: Mapping[str, Protocol] = {
    joint_set + rule.suffix: Protocol(
        joint_set + rule.suffix,
        joints,
        alignment,
        f"rig (head) frame, {_SET_WORDS[joint_set]}, {rule.words}",
    )
    for joint_set, joints in JOINT_SETS.items()
    for alignment, rule in ALIGNMENTS.items()
}
"""Every joint set with every alignment, e.g. "unrealego-16-pa"."""


def find_protocol(name: str) -> Protocol:
    """The protocol of that name.

    Raises:
        InputError: there is none; the message lists joint sets and alignments.
    """
    if name not in PROTOCOLS:
        suffixes = ", ".join(rule.suffix for rule in ALIGNMENTS.values() if rule.suffix)
        valid = f"{', '.join(JOINT_SETS)}; each alone or with {suffixes}"
        raise InputError(f"no protocol '{name}'", valid=f"{valid}, e.g. egocap-17-pa")
    return PROTOCOLS[name]


def same_joints(protocol: Protocol, alignment: str) -> Protocol:
    """The protocol with the same joints and another alignment."""
    return next(
        p for p in PROTOCOLS.values() if p.joints == protocol.joints and p.alignment == alignment
    )
