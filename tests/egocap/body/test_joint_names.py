import pytest

from egocap.body.joint_names import DATASET_NAMES, JOINT_ORDER, JOINT_SETS, match_labels
from egocap.body.labels import LABELS
from egocap.errors import InputError


@pytest.mark.parametrize("dataset", DATASET_NAMES)
def test_left_is_left_and_no_label_is_named_twice(dataset):
    table = DATASET_NAMES[dataset]
    assert len(set(table.values())) == len(table)
    for theirs, ours in table.items():
        if ours not in ("head", "neck"):
            left = theirs.lower().startswith(("left", "b_l_")) or theirs.endswith("_l")
            assert ours.startswith("left_") == left, (theirs, ours)


@pytest.mark.parametrize(("dataset", "count"), [
    ("egocap", 18), ("unrealego", 16), ("ego4view", 16), ("mo2cap2", 15), ("egobody3m", 26),
    ("renderpeople", 73)])  # fmt: skip
def test_orders_hold_every_joint_with_a_label_once(dataset, count):
    order = JOINT_ORDER[dataset]
    assert len(order) == len(set(order)) == count
    assert set(DATASET_NAMES[dataset]) <= set(order)


def test_sizes_of_the_sets():
    for name, joints in JOINT_SETS.items():
        assert len(joints) == int(name.rpartition("-")[2]) == len(set(joints))


def test_names_are_found_in_any_order_and_case_and_strangers_left_out():
    found = match_labels(["ball_r", "pelvis", "Hand_L", "neck01"], "unrealego")
    assert {i: LABELS[j] for i, j in found.items()} == {
        0: "right_foot", 2: "left_wrist", 3: "neck",
    }  # fmt: skip


def test_other_names_are_recognised():
    theirs = list(DATASET_NAMES["unrealego"])[1:]
    with pytest.raises(InputError, match="15 of them are names of unrealego"):
        match_labels(theirs)
    with pytest.raises(InputError, match="16 of them are names of unrealego"):
        match_labels(["head", *theirs])
    with pytest.raises(InputError, match="0 of 2 names are joints of egocap: nose, eye"):
        match_labels(["nose", "eye"])
    with pytest.raises(InputError, match="occurs twice"):
        match_labels(["neck", "Neck"])
    with pytest.raises(InputError, match="ego4view"):
        match_labels(["neck"], "coco")
