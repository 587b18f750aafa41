import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import procrustes

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.evaluation import GroundTruth, evaluate_pose

KEYS = {
    "mpjpe_mm", "pa_mpjpe_mm", "upper_mm", "lower_mm", "median_mm", "p95_mm", "accel_error",
    "pck20", "auc20", "per_joint_mm", "visible_share", "frames", "protocol",
}  # fmt: skip


def motion(frames=200, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(frames, 18, 3)) * 0.5, np.arange(frames) / 30


def test_errors_in_millimetres_by_hand():
    truth, times = motion(150)
    predicted = truth.copy()
    predicted[:, LABELS.index("head")] += 5.0  # does not count
    predicted[:, LABELS.index("left_hand"), 0] += 0.16
    predicted[:, LABELS.index("right_foot"), 2] -= 0.08
    predicted[:, LABELS.index("neck"), 1] += 0.017
    report = evaluate_pose(predicted, GroundTruth(truth, times))
    assert report.mpjpe_mm == pytest.approx((160 + 80 + 17) / 17)
    assert report.upper_mm == pytest.approx(20)
    assert report.lower_mm == pytest.approx(10)
    assert report.median_mm == pytest.approx(0, abs=1e-9)
    assert report.max_mm == pytest.approx(160)
    assert report.per_joint_mm["left_hand"] == pytest.approx(160)
    assert report.per_joint_mm["right_hand"] == 0
    assert "head" not in report.per_joint_mm and len(report.per_joint_mm) == 17
    assert report.accel_error == pytest.approx(0, abs=1e-9)
    assert report.frames == 150 and report.protocol == "egocap-17"


def test_pa_mpjpe_agrees_with_scipy_and_never_exceeds_the_rigid_squares():
    truth, times = motion(40)
    predicted = truth + motion(40, seed=1)[0] * 0.1
    report = evaluate_pose(predicted, GroundTruth(truth, times))
    errors = []
    for p, t in zip(predicted[:, 1:], truth[:, 1:], strict=True):
        unit_truth, fitted, _ = procrustes(t, p)
        size = np.linalg.norm(t - t.mean(0))
        errors.append(1000 * size * np.linalg.norm(fitted - unit_truth, axis=-1))
    assert report.pa_mpjpe_mm == pytest.approx(np.mean(errors))
    assert report.other_protocols_mm["egocap-17-pa"] == report.pa_mpjpe_mm


def test_another_protocol_measures_what_it_says():
    truth, times = motion(40)
    predicted = 1.1 * truth + 0.1
    assert evaluate_pose(predicted, GroundTruth(truth, times)).mpjpe_mm > 100
    report = evaluate_pose(predicted, GroundTruth(truth, times), protocol="egocap-17-pa")
    assert report.mpjpe_mm == pytest.approx(0, abs=1e-6)
    assert report.protocol == "egocap-17-pa" and "egocap-17" in report.other_protocols_mm


def test_seen_and_hidden_joints_apart():
    truth, times = motion(60)
    seen = np.zeros((60, 18), bool)
    seen[:30] = True
    predicted = truth.copy()
    predicted[30:] += [0.0, 0.0, 0.04]
    report = evaluate_pose(predicted, GroundTruth(truth, times, seen=seen))
    assert report.visible_share == 0.5
    assert (report.visible_mm, report.hidden_mm) == pytest.approx((0, 40))
    assert evaluate_pose(predicted, GroundTruth(truth, times)).visible_share is None
    everything = GroundTruth(truth, times, seen=np.ones_like(seen))
    assert evaluate_pose(predicted, everything).hidden_mm is None


@settings(deadline=None, max_examples=15)
@given(st.integers(1, 3))
def test_few_frames_score_like_many(frames):
    truth, times = motion(6)
    predicted = truth + motion(6, seed=3)[0] * 0.05
    whole = evaluate_pose(predicted, GroundTruth(truth, times))
    parts = [
        evaluate_pose(
            predicted[i : i + frames], GroundTruth(truth[i : i + frames], times[i : i + frames])
        )
        for i in range(0, 6, frames)
    ]
    for key in ("mpjpe_mm", "pa_mpjpe_mm", "upper_mm", "lower_mm"):
        assert np.mean([getattr(p, key) for p in parts]) == pytest.approx(getattr(whole, key))


def test_what_cannot_be_measured_is_null():
    truth, times = motion(2)
    data = json.loads(evaluate_pose(truth, GroundTruth(truth, times)).to_json())
    assert data.keys() >= KEYS
    for key in ("accel_error", "pck20", "auc20", "visible_share", "mpjpe_ci95_mm"):
        assert data[key] is None
    assert data["mpjpe_mm"] == 0


def test_interval_holds_the_mean_and_repeats():
    truth, times = motion(300)
    predicted = truth + motion(300, seed=2)[0] * 0.02
    first, second = (evaluate_pose(predicted, GroundTruth(truth, times)) for _ in range(2))
    low, high = first.mpjpe_ci95_mm
    assert low < first.mpjpe_mm < high
    assert first == second


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite_names_frame_and_joint(bad):
    truth, times = motion(10)
    predicted = truth.copy()
    predicted[7, LABELS.index("left_wrist"), 1] = bad
    with pytest.raises(InputError, match=r"predicted joints .* frame 7, left_wrist"):
        evaluate_pose(predicted, GroundTruth(truth, times))
    with pytest.raises(InputError, match="true joints"):
        evaluate_pose(truth, GroundTruth(predicted, times))


def test_other_frames_are_refused():
    truth, times = motion(10)
    with pytest.raises(InputError, match=r"9 frames.*10"):
        evaluate_pose(truth[:9], GroundTruth(truth, times))
    with pytest.raises(InputError, match="no frame"):
        evaluate_pose(truth[:0], GroundTruth(truth[:0], times[:0]))


@pytest.mark.parametrize("shape", [(10, 17, 3), (18, 10, 3), (10, 3, 18), (10, 54)])
def test_other_axes_are_refused(shape):
    truth, times = motion(10)
    with pytest.raises(InputError, match=r"\(T, 18, 3\)"):
        evaluate_pose(np.zeros(shape), GroundTruth(truth, times))


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("times", np.arange(9.0), r"times of shape \(9,\) .*\(10,\)"),
        ("times", np.zeros(10), "times that do not increase"),
        ("times", np.full(10, np.nan), "times that do not increase"),
        ("T_world_head", np.eye(4), r"head poses of shape \(4, 4\)"),
        ("contact", np.ones((10, 2), bool), r"contacts of shape \(10, 2\)"),
        ("seen", np.ones((10, 17), bool), r"visibility of shape \(10, 17\)"),
    ],
)
def test_a_truth_of_other_frames_is_refused(name, value, says):
    truth, times = motion(10)
    with pytest.raises(InputError, match=says):
        GroundTruth(**{"joints_head": truth, "times": times, name: value})
