"""Named protocols: which joints count, and what may be aligned before errors are measured.

A number without its protocol cannot be compared, so every report carries one and prints it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.evaluate.alignment import align_rigid, align_root, align_sequence, align_similarity
from egocap.labels import EVALUATED, LABEL_INDEX, LIMBS

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

Alignment = Callable[[Array, Array], Array]

ALIGNMENTS: Mapping[str, Alignment] = {
    "none": lambda predicted, truth: predicted,
    "mid-hip": lambda predicted, truth: align_root(predicted, truth, HIPS),
    "rigid": lambda predicted, truth: _on_evaluated(align_rigid, predicted, truth),
    "similarity": lambda predicted, truth: _on_evaluated(align_similarity, predicted, truth),
    "sequence": lambda predicted, truth: _on_evaluated(align_sequence, predicted, truth),
}


@dataclass(frozen=True)
class Protocol:
    """How a 3-D error is measured: joints, frame and alignment, under a name to quote."""

    name: str
    joints: tuple[int, ...]  # indices into `egocap.labels.LABELS`
    alignment: str  # a key of `ALIGNMENTS`
    description: str

    def align(
        self, predicted: Float[Array, "T 18 3"], truth: Float[Array, "T 18 3"]
    ) -> Float[Array, "T 18 3"]:
        """Predicted joints after this protocol's alignment to the true ones, head frame."""
        return ALIGNMENTS[self.alignment](predicted, truth)


_17 = "rig (head) frame, 17 joints without the head, "

PROTOCOLS: Mapping[str, Protocol] = {
    p.name: p
    for p in (
        Protocol("egocap-17", EVALUATED, "none", _17 + "no alignment"),
        Protocol("egocap-17-mid-hip", EVALUATED, "mid-hip", _17 + "mid-hips moved together"),
        Protocol("egocap-17-rigid", EVALUATED, "rigid", _17 + "each frame rigidly aligned"),
        Protocol(
            "egocap-17-pa",
            EVALUATED,
            "similarity",
            _17 + "each frame aligned by a similarity (Procrustes with scale)",
        ),
        Protocol(
            "egocap-17-sequence",
            EVALUATED,
            "sequence",
            _17 + "the whole sequence aligned by one similarity",
        ),
    )
}


def find_protocol(name: str) -> Protocol:
    """The protocol of that name.

    Raises:
        InputError: there is none; the message lists the names.
    """
    if name not in PROTOCOLS:
        raise InputError(f"no protocol '{name}'", valid=PROTOCOLS)
    return PROTOCOLS[name]


def _on_evaluated(align: Alignment, predicted: Array, truth: Array) -> Array:
    """Align by the joints that count only; the head, which does not, is left where it was."""
    aligned, index = predicted.copy(), list(EVALUATED)
    aligned[:, index] = align(predicted[:, index], truth[:, index])
    return aligned
