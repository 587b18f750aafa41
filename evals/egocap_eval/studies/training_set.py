"""The effect of the training set's size on a detector: fewer people or frames, the same steps.

The paper leaves three of its six people out (2.5 points of PCK lost), nine tenths of the frames (2
lost) and half of them (none lost). Here the same is done with six people before a green screen,
with all of the paper's augmentation; detectors are scored on other people in real places.
Source: EgoCap paper, section 5.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes

from egocap.data.dataset import find_sequences
from egocap.data.sequence import open_sequence
from egocap.errors import InputError
from egocap.evaluation.table import Table
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.augmentation import ROWS as AUGMENTATIONS
from egocap_eval.studies.small_detectors import (
    Trainings,
    difference,
    prepare_training,
    summary,
    table,
    with_error,
)

if TYPE_CHECKING:
    from egocap.detect.train.examples import Views, ViewStore

ALL = "all"
Subset = Callable[["ViewStore", Sequence[int]], "ViewStore"]
SUBSETS: Mapping[str, tuple[str, Subset]] = {
    "half of the people": ("half_subjects_loss", lambda store, who: half_of_people(store, who)),
    "half of the frames": ("half_of_frames_loss", lambda store, who: every_nth(store, 2)),
    "a tenth of the frames": ("tenth_of_frames_loss", lambda store, who: every_nth(store, 10)),
}
"""Subsets of the training set, and the key of what each costs."""


def study(trainings: OmitArgPrefixes[Trainings]) -> Outcome:
    """Train detectors on subsets of the same footage, for the same steps, and compare them."""
    with prepare_training(trainings) as common:
        whole, people = common.footage, identify_people(find_sequences(trainings.footage))
        if len(set(people)) < 2:
            raise InputError("footage of one person cannot be halved", valid="two or more people")
        if len(people) != len(whole.sequences):
            raise InputError("some of the footage cannot be read", valid="whole sequences")
        subsets = {ALL: whole} | {
            name: subset(whole, people) for name, (_, subset) in SUBSETS.items()
        }
        cases = {name: (part, AUGMENTATIONS["+ recolouring"]) for name, part in subsets.items()}
        found = common.compare(cases)
    rows = {name: summary(scores) for name, scores in found.items()}
    losses = {key: difference(found[ALL], found[name]) for name, (key, _) in SUBSETS.items()}
    sizes = {name: len(part) for name, part in subsets.items()}
    result = {"rows": rows, "people": len(set(people)), "views": sizes, **losses}
    lost = tuple((name, with_error(losses[key])) for name, (key, _) in SUBSETS.items())
    tables = [table(rows), Table("points of PCK lost (standard error)", ("left", "lost"), lost)]
    return Outcome(result, tables)


def identify_people(folders: Sequence[Path]) -> list[int]:
    """An index of the person in each sequence, equal for the same person."""
    who = [open_sequence(folder).body.rest_joints.tobytes() for folder in folders]
    first = list(dict.fromkeys(who))
    return [first.index(person) for person in who]


def half_of_people(store: ViewStore, people: Sequence[int]) -> ViewStore:
    """Every second person's sequences."""
    from egocap.detect.train.examples import ViewStore

    pairs = zip(store.sequences, people, strict=True)
    return ViewStore(tuple(views for views, person in pairs if person % 2 == 0))


def every_nth(store: ViewStore, n: int) -> ViewStore:
    """Every n-th frame of both views, without reading any."""
    from egocap.detect.train.examples import ViewStore

    # a frame's two views follow each other, so that one slice would take one camera alone
    parts = (_sliced(views, slice(v, None, 2 * n)) for views in store.sequences for v in range(2))
    return ViewStore(tuple(views for views in parts if len(views)))


def _sliced(views: Views, rows: slice) -> Views:
    from egocap.detect.train.examples import Views

    parts = None if views.parts is None else views.parts[rows]
    return Views(
        views.images[rows], parts, views.points[rows], views.state[rows], views.magnification[rows]
    )
