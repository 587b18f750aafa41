"""The effect of augmentation on a detector that is trained on green-screen footage.

Three detectors are trained for the same number of steps: on the green screen as it is, with
backgrounds replaced, and with the wearer recoloured besides. Scale, gamma and mirroring are in all,
as in the paper. They are scored on footage of other people in real places.
Source: EgoCap paper, section 5.3 and Table 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tyro.conf import OmitArgPrefixes

from egocap.detect.train.config import NO_AUGMENTATION, AugmentationConfig
from egocap.errors import InputError
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.small_detectors import Trainings, prepare_training, summary, table

_PLAIN = replace(NO_AUGMENTATION, scale=0.15, gamma=2.0)

ROWS: Mapping[str, AugmentationConfig] = {
    "green screen only": _PLAIN,
    "+ background": replace(_PLAIN, background=1.0),
    "+ recolouring": replace(_PLAIN, background=1.0, recolour=0.7),
}
"""Rows of the table, each adding to the previous one."""


def study(trainings: OmitArgPrefixes[Trainings]) -> Outcome:
    """Train detectors on green-screen footage with and without augmentation, and compare them."""
    with prepare_training(trainings) as common:
        if any(s.parts is None for s in common.footage.sequences):
            raise InputError(
                "footage without part labels cannot be augmented", valid="train-chroma"
            )
        cases = {name: (common.footage, augmentation) for name, augmentation in ROWS.items()}
        found = common.compare(cases)
        seen, scored = len(common.footage), min(trainings.views, len(common.held_out))
    result = {name: summary(scores) for name, scores in found.items()}
    sizes = {"training_views": seen, "held_out_views": scored}
    return Outcome({"rows": result, **sizes}, [table(result)], missed(result))


def missed(result: Mapping[str, Mapping[str, Mapping[str, float | None]]]) -> list[str]:
    """Gains below the paper's."""
    plain, background, recolour = (result[name]["pck"]["mean"] or 0.0 for name in ROWS)
    gaps = []
    if background - plain < 5.0:
        gaps.append(f"background: {background - plain:+.1f} points of PCK, not 5 or more")
    if recolour - background <= 0.0:
        gaps.append(f"recolouring: {recolour - background:+.1f} points of PCK, not above 0")
    return gaps
