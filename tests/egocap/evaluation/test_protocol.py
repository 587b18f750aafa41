import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.errors import InputError
from egocap.evaluation import GroundTruth, evaluate_pose
from egocap.evaluation.protocol import (
    ALIGNMENTS,
    BONES,
    LOWER_LIMBS,
    PROTOCOLS,
    UPPER_LIMBS,
    find_protocol,
)

TIMES = np.arange(20) / 30


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


@pytest.mark.parametrize("seed", range(12))
def test_missing_joints_are_masked_in_every_protocol_or_refused(seed):
    """What a missing joint holds changes no score; bones are not made where an end is missing."""
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(20, 18, 3))
    valid = rng.random((20, 18)) >= rng.choice([0.02, 0.3, 0.9])
    valid[0] = False
    predicted = truth + 0.1 * rng.normal(size=truth.shape)
    for name, rules in PROTOCOLS.items():
        scores = []
        for filler in (np.nan, 0.0, 1e6):
            made = np.where(valid[..., None], predicted, filler)
            try:
                report = evaluate_pose(made, GroundTruth(truth, TIMES), valid=valid,
                                       protocol=name)  # fmt: skip
            except InputError as error:
                assert ALIGNMENTS[rules.alignment].needs, error
                scores.append(str(error))
            else:
                scores.append(report.to_json())
        assert len(set(scores)) == 1, name


def test_bone_adjustment_needs_the_chain_to_the_neck():
    valid = np.ones((3, 18), bool)
    rules = find_protocol("egocap-17-ba")
    valid[1, LABEL_INDEX["left_hand"]] = False  # an end: nothing hangs on it
    assert rules.defined(valid)
    valid[1, LABEL_INDEX["left_elbow"]] = False  # the wrist hangs on it
    assert not rules.defined(valid)
    truth = np.random.default_rng(0).normal(size=(3, 18, 3))
    report = evaluate_pose(truth, GroundTruth(truth, TIMES[:3]), valid=valid)
    assert "egocap-17-pa" in report.other_protocols_mm
    assert not [name for name in report.other_protocols_mm if "-ba" in name]
    with pytest.raises(InputError, match="between it and the neck"):
        evaluate_pose(truth, GroundTruth(truth, TIMES[:3]), valid=valid, protocol="egocap-17-ba")


def test_poses_of_few_joints_are_not_aligned_in_shape():
    """A similarity takes any single joint to its true place."""
    truth = np.random.default_rng(0).normal(size=(3, 18, 3))
    predicted, valid = truth + 0.1, np.zeros((3, 18), bool)
    valid[0, 1:4] = True
    given = predicted, GroundTruth(truth, TIMES[:3])
    assert "egocap-17-pa" in evaluate_pose(*given, valid=valid).other_protocols_mm
    valid[1, 1] = True
    report = evaluate_pose(*given, valid=valid)
    assert report.pa_mpjpe_mm is None
    assert not [name for name in report.other_protocols_mm if name.endswith(("-pa", "-rigid"))
                and "sequence" not in name]  # fmt: skip
    with pytest.raises(InputError, match="at least 3 joints"):
        evaluate_pose(*given, valid=valid, protocol="egocap-17-rigid")
