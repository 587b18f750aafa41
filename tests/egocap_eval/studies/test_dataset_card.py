"""The data set card: what is missing is named, and why a joint is seldom seen."""

import numpy as np

from egocap.body.labels import LABELS
from egocap.cameras.rig_files import load_rig
from egocap_eval.studies import dataset_card
from egocap_sim.core.resources import rig_file


def result(**seldom) -> dict:
    row = {"out_of_view": 5.0, "hidden_by_the_wearer": 20.0, "hidden_by_others": 1.0,
           "seen_by_any": 80.0, "reached": 100.0, "seen_where_reached": 80.0}  # fmt: skip
    joints = {label: row | seldom.get(label, {}) for label in LABELS}
    return {"joints": joints, "people": 250, "frames": 20_000}


def test_a_joint_that_rigs_cannot_reach_is_explained_and_not_missed():
    some = result(left_foot={"seen_by_any": 21.0, "out_of_view": 60.0, "seen_where_reached": 44.0})
    reached = np.ones((3, len(LABELS)), bool)
    reached[1:, LABELS.index("left_foot")] = False
    lenses = np.array([[190.0, 25.0], [150.0, 5.0], [150.0, 7.0]])
    why = dataset_card.seldom_seen(some, reached, lenses)
    assert list(why) == ["left_foot"]
    for words in ("21.0 % seen", "60.0 %", "1 rigs reach it (median 190 degrees, 25 cm)",
                  "2 rigs do not (median 150 degrees, 6 cm)", "44.0 % seen"):  # fmt: skip
        assert words in why["left_foot"]
    assert dataset_card.missed(some) == []


def test_what_falls_short_is_missed():
    few = result(neck={"seen_by_any": 30.0, "seen_where_reached": 31.0}) | {"people": 7}
    short = dataset_card.missed(few)
    assert len(short) == 2 and "neck" in short[0] and "7 people" in short[1]


def test_lenses_are_those_of_the_rig():
    across, ahead = dataset_card._lenses(load_rig(rig_file("egorig1")))
    assert 175 < across < 185 and 5 < ahead < 60
