"""Measures by name, each against the formula written out once more, whatever the batch."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation
from scipy.stats import scoreatpercentile

from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.errors import InputError
from egocap.evaluation.alignment import align_sequence, resize_bones
from egocap.evaluation.measures import MEASURES, find_measure, measure
from egocap.evaluation.metrics import bootstrap_interval, estimate_planted, paired_interval
from egocap.evaluation.pose_errors import TOES, GroundTruth, PoseErrors
from egocap.evaluation.protocol import BONES, TREE, find_protocol
from egocap.evaluation.scoring import evaluate_pose
from egocap.evaluation.world_metrics import ROLLS


def motion(frames=90, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    truth = 0.5 * rng.normal(size=(1, 18, 3)) + 0.2 * np.cumsum(
        0.1 * rng.normal(size=(frames, 18, 3)), 0
    )
    return truth + noise * rng.normal(size=truth.shape), truth, np.arange(frames) / 30


def scored(**more):
    predicted, truth, times = motion(noise=0.1)
    return PoseErrors.between(predicted, GroundTruth(truth, times), **more)


def test_against_loops():
    predicted, truth, _ = motion(noise=0.1)
    errors = [[1000 * sum((p - t) ** 2) ** 0.5 for p, t in zip(a[1:], b[1:], strict=True)]
              for a, b in zip(predicted, truth, strict=True)]  # fmt: skip
    flat = [e for row in errors for e in row]
    s = scored()
    assert measure(s, "mpjpe_mm") == pytest.approx(sum(flat) / len(flat))
    assert measure(s, "max_mm") == pytest.approx(max(flat))
    assert measure(s, "p90_mm") == pytest.approx(np.quantile(flat, 0.9))
    for limit in (100, 150):
        share = 100 * sum(e <= limit for e in flat) / len(flat)
        assert measure(s, f"pck3d_{limit}") == pytest.approx(share)
    grid = np.linspace(0, 150, 20001)
    curve = [np.mean(np.array(flat) <= t) for t in grid]
    assert measure(s, "auc3d_150") == pytest.approx(100 * np.mean(curve), abs=0.02)
    speeds = [
        np.linalg.norm((predicted[i + 1, j] - predicted[i, j] - truth[i + 1, j] + truth[i, j]) * 30)
        for i in range(89)
        for j in range(1, 18)
    ]
    assert measure(s, "velocity_error") == pytest.approx(np.mean(speeds))
    second = [
        np.linalg.norm(30**2 * (d[i - 1, j] - 2 * d[i, j] + d[i + 1, j]))
        for d in (predicted - truth,)
        for i in range(1, 89)
        for j in range(1, 18)
    ]
    assert measure(s, "accel_error") == pytest.approx(np.mean(second))
    lengths = np.array([[np.linalg.norm(p[a] - p[b]) for a, b in BONES] for p in predicted])
    assert measure(s, "bone_drift_mm") == pytest.approx(1000 * lengths.std(0).mean())


def test_parts_percentiles_and_bones_against_loops():
    predicted, truth, times = motion(noise=0.1)
    seen = np.random.default_rng(2).random((90, 18)) < 0.6
    s = PoseErrors.between(predicted, GroundTruth(truth, times, seen=seen))
    off = 1000 * np.sqrt(((predicted - truth) ** 2).sum(-1))
    names = {"upper_mm": ("shoulder", "elbow", "wrist", "hand"),
             "lower_mm": ("hip", "knee", "ankle", "foot")}  # fmt: skip
    for name, parts in names.items():
        rows = [off[:, j] for j, label in enumerate(LABELS) if label.split("_")[-1] in parts]
        assert measure(s, name) == pytest.approx(np.mean(rows))
    pairs = [(t, j) for t in range(90) for j in range(1, 18)]
    for name, wanted in (("visible_mm", True), ("hidden_mm", False)):
        chosen = [off[t, j] for t, j in pairs if seen[t, j] == wanted]
        assert measure(s, name) == pytest.approx(sum(chosen) / len(chosen))
    flat = sorted(off[t, j] for t, j in pairs)
    for name, percent in (("median_mm", 50), ("p95_mm", 95), ("p99_mm", 99)):
        assert measure(s, name) == pytest.approx(scoreatpercentile(flat, percent))
    bones = [abs(np.linalg.norm(p[a] - p[b]) - np.linalg.norm(t[a] - t[b]))
             for p, t in zip(predicted, truth, strict=True) for a, b in BONES]  # fmt: skip
    assert measure(s, "bone_error_mm") == pytest.approx(1000 * sum(bones) / len(bones))


def test_feet_against_loops():
    predicted, truth, times = motion(noise=0.01)
    rng = np.random.default_rng(5)
    turned = Rotation.from_euler("zyx", rng.normal(size=(90, 3))).as_matrix()
    T = np.tile(np.eye(4), (90, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turned, rng.normal(size=(90, 3))
    contact = np.repeat(rng.random((9, 4)) < 0.6, 10, axis=0)
    speed = np.repeat(rng.choice([0.03, 0.4], (9, 2)), 10, axis=0)  # the faster toes roll off
    for foot, toe in enumerate(TOES):
        place = np.cumsum(speed[:, foot] * np.gradient(times))[:, None] * [0.6, 0.8, 0.0]
        error = predicted[:, toe] - truth[:, toe]
        truth[:, toe] = np.einsum("tji,tj->ti", turned, place - T[:, :3, 3])
        predicted[:, toe] = truth[:, toe] + error
    s = PoseErrors.between(predicted, GroundTruth(truth, times, T_world_head=T, contact=contact))
    assert s.world is not None
    speeds, planted, found = [], [], []
    for foot, (toe, heel_column, toe_column) in enumerate(
        ((LABEL_INDEX["left_foot"], 0, 1), (LABEL_INDEX["right_foot"], 2, 3))
    ):
        world, true = (
            [turned[t] @ joints[t, toe] + T[t, :3, 3] for t in range(90)]
            for joints in (predicted, truth)
        )
        ends = [(max(t - 1, 0), min(t + 1, 89)) for t in range(90)]  # there with one neighbour
        stays = [
            np.hypot(*(true[last] - true[first])[:2]) <= ROLLS * (times[last] - times[first])
            for first, last in ends
        ]
        for first, last in ends:
            around = range(first, last + 1)
            if all(contact[i, toe_column] and stays[i] for i in around):
                moved = (world[last] - world[first]) / (times[last] - times[first])
                speeds.append(np.hypot(*moved[:2]))
        assert 0 < np.count_nonzero(stays) < 90
        planted += [contact[t, heel_column] or contact[t, toe_column] for t in range(90)]
        found += list(estimate_planted(s.world.joints[:, TOES], times)[:, foot])
    assert measure(s, "foot_skate") == pytest.approx(np.mean(speeds))
    both = sum(f and p for f, p in zip(found, planted, strict=True))
    assert measure(s, "contact_f1") == pytest.approx(2 * both / (sum(found) + sum(planted)))


@pytest.mark.parametrize("suffix", ["rigid", "pa", "sequence", "sequence-rigid", "mid-hip"])
def test_alignments_against_a_search(suffix):
    """The closed form against a numerical minimiser that knows nothing of it."""
    predicted, truth, times = motion(4, noise=0.05)
    predicted = predicted @ Rotation.from_rotvec([0.4, -0.2, 0.3]).as_matrix().T * 1.2 + 0.3
    rules = find_protocol(f"egocap-17-{suffix}")
    found = PoseErrors.between(predicted, GroundTruth(truth, times), protocol=rules.name)
    joints = list(rules.joints)
    whole = suffix.startswith("sequence")
    for t in (slice(0, 4),) if whole else (slice(0, 1), slice(3, 4)):
        p, q = predicted[t][:, joints].reshape(-1, 3), truth[t][:, joints].reshape(-1, 3)

        def off(x, p=p, q=q):
            scale = np.exp(x[6]) if suffix in ("pa", "sequence") else 1.0
            return (q - scale * Rotation.from_rotvec(x[:3]).apply(p) - x[3:6]).ravel()

        if suffix == "mid-hip":
            hips = [joints.index(LABEL_INDEX[f"{side}_hip"]) for side in ("left", "right")]
            errors = np.linalg.norm(p - p[hips].mean(0) - q + q[hips].mean(0), axis=-1)
        else:
            best = least_squares(off, np.zeros(7), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
            errors = np.linalg.norm(off(best).reshape(-1, 3), axis=-1)
        np.testing.assert_allclose(found.joint_errors[t][:, joints].ravel(), errors, atol=1e-6)


OF_JOINTS = ("mpjpe_mm", "pa_mpjpe_mm", "upper_mm", "lower_mm", "visible_mm", "hidden_mm",
             "pck3d_100", "pck3d_150", "auc3d_150", "bone_error_mm")  # fmt: skip


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("name", OF_JOINTS)
def test_measures_do_not_depend_on_how_many_frames_are_scored_together(name, size):
    predicted, truth, times = motion(6, noise=0.1)
    seen = np.broadcast_to(np.arange(18) % 3 > 0, (6, 18))

    def scored_part(rows):
        reference = GroundTruth(truth[rows], times[rows], seen=seen[rows])
        value = measure(PoseErrors.between(predicted[rows], reference), name)
        assert value is not None
        return value

    parts = [scored_part(slice(i, i + size)) for i in range(0, 6, size)]
    assert np.mean(parts) == pytest.approx(scored_part(slice(None)))


def test_bone_adjusted_against_a_walk_along_the_tree():
    predicted, truth, _ = motion(3, noise=0.1)
    adjusted = find_protocol("egocap-18-ba").align(predicted, truth)
    for p, t, a in zip(predicted, truth, adjusted, strict=True):
        walked = p.copy()
        for parent, child in TREE:
            along = (p[child] - p[parent]) / np.linalg.norm(p[child] - p[parent])
            walked[child] = walked[parent] + along * np.linalg.norm(t[child] - t[parent])
        unit_truth, fitted, _ = procrustes(t, walked)
        size = np.linalg.norm(t - t.mean(0))
        np.testing.assert_allclose(a, fitted * size + t.mean(0), atol=1e-9)
        assert np.abs(fitted - unit_truth).max() > 1e-3


def test_resized_bones_have_their_lengths_and_directions():
    points = motion(4)[1]
    lengths = np.full((4, len(TREE)), 0.3)
    resized = resize_bones(points, lengths, TREE)
    for a, b in TREE:
        before, after = points[:, b] - points[:, a], resized[:, b] - resized[:, a]
        np.testing.assert_allclose(np.linalg.norm(after, axis=-1), 0.3)
        np.testing.assert_allclose(np.cross(before, after), 0, atol=1e-12)


def test_one_rigid_alignment_of_a_sequence_keeps_its_scale():
    truth = motion()[1]
    np.testing.assert_allclose(
        align_sequence(1.1 * truth, truth, scaled=False).std(), (1.1 * truth).std(), rtol=1e-2
    )
    assert np.abs(align_sequence(truth + 1.0, truth, scaled=False) - truth).max() < 1e-9


@pytest.mark.parametrize(
    "protocol", ["egocap-17", "egocap-17-pa", "unrealego-16-ba", "mo2cap2-15-mid-hip"]
)
def test_errors_do_not_depend_on_the_batch(protocol):
    predicted, truth, times = motion(12, noise=0.1)
    whole = PoseErrors.between(predicted, GroundTruth(truth, times), protocol=protocol).joint_errors
    for size in (1, 2, 3):
        parts = [
            PoseErrors.between(
                predicted[i : i + size],
                GroundTruth(truth[i : i + size], times[i : i + size]),
                protocol=protocol,
            ).joint_errors
            for i in range(0, 12, size)
        ]
        joints = list(find_protocol(protocol).joints)
        np.testing.assert_allclose(np.concatenate(parts)[:, joints], whole[:, joints], atol=1e-12)


@pytest.mark.parametrize(
    "name", [name for name in MEASURES if not name.startswith(("world_", "root_"))]
)  # fmt: skip
def test_perfection_is_as_good_as_it_gets(name):
    _, truth, times = motion()
    eye = np.broadcast_to(np.eye(4), (90, 4, 4))
    contact = np.ones((90, 4), bool)
    seen = np.arange(18) % 2 == np.arange(90)[:, None] % 2
    more = {"T_world_head": eye, "contact": contact, "seen": seen}
    still = np.repeat(truth[:1], 90, axis=0)
    still[..., [LABEL_INDEX["left_foot"], LABEL_INDEX["right_foot"]], 2] = -1.6
    reference = GroundTruth(still, times, **more)
    perfect = measure(PoseErrors.between(still, reference), name)
    worse = measure(PoseErrors.between(still + 0.01, reference), name)
    assert perfect is not None and worse is not None
    if MEASURES[name].better == "lower":
        assert perfect == pytest.approx(0, abs=1e-6) and worse >= perfect - 1e-6
    else:
        assert (
            perfect == pytest.approx((MEASURES[name].unit == "%" and 100) or 1) and worse <= perfect
        )


def test_missing_joints_are_misses_and_not_errors():
    predicted, truth, times = motion()
    predicted = predicted + [0.05, 0.0, 0.0]
    valid = np.ones((90, 18), bool)
    valid[40:50] = False
    valid[:, LABEL_INDEX["left_hand"]] = False
    predicted[~valid] = np.nan
    report = evaluate_pose(predicted, GroundTruth(truth, times), valid=valid)
    assert report.mpjpe_mm == pytest.approx(50)
    assert report.per_joint_mm["left_hand"] is None
    assert report.coverage_share == pytest.approx(valid[:, 1:].mean())
    assert report.pck3d_150 == pytest.approx(100 * valid[:, 1:].mean())
    assert report.accel_error == pytest.approx(0, abs=1e-9)
    assert report.pa_mpjpe_mm == pytest.approx(0, abs=1e-6)
    assert "joints predicted" in report.to_text()
    errors = PoseErrors.between(predicted, GroundTruth(truth, times), valid=valid).per_frame
    assert np.isnan(errors[40:50]).all() and np.isfinite(errors[:40]).all()


def test_nothing_predicted_or_no_hips_is_refused():
    predicted, truth, times = motion()
    valid = np.zeros((90, 18), bool)
    with pytest.raises(InputError, match="no joint of egocap-17"):
        evaluate_pose(predicted, GroundTruth(truth, times), valid=valid)
    valid[:, : LABEL_INDEX["left_hip"]] = True
    with pytest.raises(InputError, match="both hips"):
        evaluate_pose(
            predicted, GroundTruth(truth, times), valid=valid, protocol="egocap-17-mid-hip"
        )
    assert evaluate_pose(predicted, GroundTruth(truth, times), valid=valid).lower_mm is None


def test_unknown_measure_lists_the_known():
    with pytest.raises(InputError, match=r"mpjpe_mm, pa_mpjpe_mm.*contact_f1"):
        find_measure("mpjpe")


def test_pairing_sees_what_the_spread_of_frames_hides():
    rng = np.random.default_rng(0)
    hard = np.repeat(rng.exponential(30.0, 40), 30)  # seconds differ, frames of one are alike
    first = hard + rng.normal(size=len(hard))
    second = hard + 1.0 + rng.normal(size=len(hard))
    low, high = paired_interval(first, second, np.random.default_rng(1), block=30)
    assert 0 < low < 1 < high
    alone = bootstrap_interval(first, np.random.default_rng(1), block=30)
    assert alone[1] - alone[0] > 10 * (high - low)
    with pytest.raises(InputError, match="paired"):
        paired_interval(first[:-1], second, rng)


def test_every_set_has_a_protocol_for_every_alignment():
    assert find_protocol("unrealego-16").joints == tuple(
        i for i, n in enumerate(LABELS) if not n.endswith("hand")
    )
    with pytest.raises(InputError, match="unrealego-16, mo2cap2-15; each alone or with -mid-hip"):
        find_protocol("unrealego-16-procrustes")
