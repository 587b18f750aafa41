import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.evaluation.protocol import (
    BONES,
    LOWER_LIMBS,
    PROTOCOLS,
    UPPER_LIMBS,
    find_protocol,
)


def test_egocap_17_is_all_joints_but_the_head_untouched():
    protocol = find_protocol("egocap-17")
    assert [LABELS[j] for j in protocol.joints] == [n for n in LABELS if n != "head"]
    pose = np.random.default_rng(0).normal(size=(2, 18, 3))
    np.testing.assert_array_equal(protocol.align(pose, pose + 1), pose)


def test_the_limbs_of_the_paper():
    assert len(UPPER_LIMBS) == len(LOWER_LIMBS) == 8
    assert set(UPPER_LIMBS) | set(LOWER_LIMBS) | {0, 1} == set(range(18))
    assert {LABELS[j].split("_")[1] for j in UPPER_LIMBS} == {
        "shoulder", "elbow", "wrist", "hand",
    }  # fmt: skip


def test_bones_are_rigid_segments():
    names = {(LABELS[a], LABELS[b]) for a, b in BONES}
    assert ("left_elbow", "left_wrist") in names and ("left_hip", "right_hip") in names
    assert len(names) == 13
    assert not any("neck" in n for pair in names for n in pair)
    assert ("left_shoulder", "left_hip") not in names


@pytest.mark.parametrize("name", [n for n, p in PROTOCOLS.items() if p.alignment != "none"])
def test_alignments_undo_what_they_allow_whatever_the_head_does(name):
    rng = np.random.default_rng(1)
    truth = rng.normal(size=(3, 18, 3))
    predicted = truth + [0.1, 0.2, 0.3]
    others = [j for j in range(18) if j not in PROTOCOLS[name].joints]
    predicted[:, others] += rng.normal(size=(3, len(others), 3))
    before = predicted.copy()
    aligned = PROTOCOLS[name].align(predicted, truth)
    joints = list(PROTOCOLS[name].joints)
    np.testing.assert_allclose(aligned[:, joints], truth[:, joints], atol=1e-9)
    np.testing.assert_array_equal(predicted, before)


def test_unknown_name_lists_the_known():
    with pytest.raises(InputError, match="egocap-17-pa"):
        find_protocol("h36m")
