import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from egocap.evaluation.alignment import (
    align_rigid,
    align_root,
    align_sequence,
    align_similarity,
    fit_similarity,
    resize_bones,
)

seeds = st.integers(0, 2**32 - 1)


def poses(rng, frames=6, joints=17):
    return rng.normal(size=(frames, joints, 3))


@settings(deadline=None, max_examples=40)
@given(seeds, st.floats(0.2, 5.0))
def test_a_similarity_is_undone(seed, scale):
    rng = np.random.default_rng(seed)
    truth = poses(rng)
    R = Rotation.random(len(truth), rng=rng).as_matrix()
    moved = scale * truth @ R.swapaxes(1, 2) + rng.normal(size=(len(truth), 1, 3))
    s, R_fit, _ = fit_similarity(moved, truth)
    np.testing.assert_allclose(align_similarity(moved, truth), truth, atol=1e-9)
    np.testing.assert_allclose(s, 1 / scale)
    np.testing.assert_allclose(R_fit, R.swapaxes(1, 2), atol=1e-9)


def test_residual_agrees_with_scipy_procrustes():
    rng = np.random.default_rng(0)
    truth = poses(rng)
    predicted = truth + 0.3 * poses(rng)
    aligned = align_similarity(predicted, truth)
    for a, p, t in zip(aligned, predicted, truth, strict=True):
        _, fitted, disparity = procrustes(t, p)  # of the unit-norm centred truth
        size = np.linalg.norm(t - t.mean(0))
        np.testing.assert_allclose(((a - t) ** 2).sum() / size**2, disparity)
        np.testing.assert_allclose(a, fitted * size + t.mean(0), atol=1e-9)


def test_rotation_agrees_with_scipy_align_vectors():
    rng = np.random.default_rng(1)
    truth = poses(rng)
    predicted = truth + 0.3 * poses(rng)
    aligned = align_rigid(predicted, truth)
    for a, p, t in zip(aligned, predicted, truth, strict=True):
        R, rssd = Rotation.align_vectors(t - t.mean(0), p - p.mean(0))
        np.testing.assert_allclose(a, R.apply(p - p.mean(0)) + t.mean(0), atol=1e-7)
        np.testing.assert_allclose(np.linalg.norm(a - t), rssd)


def test_a_mirrored_pose_is_not_reflected_onto_the_truth():
    rng = np.random.default_rng(2)
    truth = poses(rng)
    mirrored = truth * [1.0, -1.0, 1.0]
    _, R, _ = fit_similarity(mirrored, truth)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    residual = np.linalg.norm(align_similarity(mirrored, truth) - truth, axis=-1).mean()
    assert residual > 0.3
    for m, t, a in zip(mirrored, truth, align_rigid(mirrored, truth), strict=True):
        best, _ = Rotation.align_vectors(t - t.mean(0), m - m.mean(0))
        np.testing.assert_allclose(a, best.apply(m - m.mean(0)) + t.mean(0), atol=1e-6)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_the_fit_is_a_minimum(seed):
    rng = np.random.default_rng(seed)
    truth, predicted = poses(rng, 1)[0], poses(rng, 1)[0]
    s, R, t = fit_similarity(predicted, truth)

    def loss(s, R, t):
        return ((s * predicted @ R.T + t - truth) ** 2).sum()

    best = loss(s, R, t)
    for _ in range(20):
        nudge = Rotation.from_rotvec(1e-2 * rng.normal(size=3)).as_matrix()
        assert loss(s + 1e-2 * rng.normal(), nudge @ R, t + 1e-2 * rng.normal(size=3)) >= best


@pytest.mark.parametrize("align", [align_similarity, align_rigid])
def test_each_frame_is_aligned_by_itself_in_batches_of_one_two_and_three(align):
    rng = np.random.default_rng(3)
    truth, predicted = poses(rng, 6), poses(rng, 6)
    whole = align(predicted, truth)
    for size in (1, 2, 3):
        parts = [align(predicted[i : i + size], truth[i : i + size]) for i in range(0, 6, size)]
        np.testing.assert_allclose(np.concatenate(parts), whole, rtol=0, atol=1e-12)


def test_masked_joints_are_not_read():
    rng = np.random.default_rng(4)
    truth = poses(rng)
    moved = 2.0 * truth + 1.0
    mask = rng.random(truth.shape[:2]) < 0.7
    moved[~mask] = np.nan
    aligned = align_similarity(moved, truth, mask)
    np.testing.assert_allclose(aligned[mask], truth[mask], atol=1e-9)


def test_coinciding_points_map_to_the_centroid():
    truth = poses(np.random.default_rng(5), 1)
    aligned = align_similarity(np.ones_like(truth), truth)
    expected = np.broadcast_to(truth.mean(1, keepdims=True), truth.shape)
    np.testing.assert_allclose(aligned, expected)


def test_sequence_alignment_is_one_motion_for_all_frames():
    rng = np.random.default_rng(6)
    truth = poses(rng)
    R = Rotation.random(rng=rng).as_matrix()
    np.testing.assert_allclose(align_sequence(3 * truth @ R.T + 1, truth), truth, atol=1e-9)
    jumping = truth + rng.normal(size=(len(truth), 1, 3))
    assert np.abs(align_sequence(jumping, truth) - truth).max() > 0.1


def test_root_alignment_moves_only():
    rng = np.random.default_rng(7)
    truth = poses(rng)
    shift = rng.normal(size=(len(truth), 1, 3))
    np.testing.assert_allclose(align_root(truth + shift, truth, (10, 14)), truth, atol=1e-12)


def test_bones_get_their_lengths_and_keep_their_directions():
    """A chain of three joints and a fork; the joint of no bone stays."""
    points = np.array([[[0, 0, 0], [2, 0, 0], [2, 3, 0], [0, 0, 4], [7, 7, 7]]], float)
    bones = ((0, 1), (1, 2), (0, 3))
    resized = resize_bones(points, np.array([[1.0, 6.0, 0.5]]), bones)
    expected = [[[0, 0, 0], [1, 0, 0], [1, 6, 0], [0, 0, 0.5], [7, 7, 7]]]
    np.testing.assert_allclose(resized, expected)
    np.testing.assert_allclose(points[0, 1], [2, 0, 0])  # the input is left alone


def test_bone_without_length_has_no_direction():
    points = np.array([[[1, 1, 1], [1, 1, 1], [1, 1, 3]]], float)
    resized = resize_bones(points, np.array([[5.0, 5.0]]), ((0, 1), (1, 2)))
    np.testing.assert_allclose(resized, [[[1, 1, 1], [1, 1, 1], [1, 1, 6]]])


@pytest.mark.parametrize("align", [align_rigid, align_similarity, align_sequence])
def test_a_masked_joint_does_not_turn_the_others(align):
    rng = np.random.default_rng(3)
    truth = poses(rng)
    mask = np.ones(truth.shape[:2], bool)
    mask[:, 4] = False
    moved = truth @ Rotation.from_euler("z", 40, degrees=True).as_matrix().T + [1.0, 2.0, 3.0]
    moved[:, 4] += 50.0
    np.testing.assert_allclose(align(moved, truth, mask)[mask], truth[mask], atol=1e-9)


def test_rigid_alignment_of_a_sequence_keeps_the_scale():
    rng = np.random.default_rng(4)
    truth = poses(rng)
    np.testing.assert_allclose(align_sequence(3.0 * truth, truth), truth, atol=1e-9)
    rigid = align_sequence(3.0 * truth, truth, scaled=False)
    span = [np.linalg.norm(points[0, 1] - points[0, 2]) for points in (rigid, truth)]
    assert span[0] == pytest.approx(3.0 * span[1])


def test_fit_of_few_small_and_single_precision_points_is_exact():
    """One joint alone is moved onto its truth; millimetres in metres, in float32, are not lost."""
    rng = np.random.default_rng(5)
    truth = 1e-3 * poses(rng) + 100.0
    moved = (0.5 * (truth - 100.0)).astype(np.float32)
    s, _, _ = fit_similarity(moved, truth)
    np.testing.assert_allclose(s, 2.0, rtol=1e-6)
    aligned = align_similarity(moved.astype(np.float64), truth)
    np.testing.assert_allclose(aligned, truth, atol=1e-9)
    alone = np.zeros(truth.shape[:2], bool)
    alone[:, 3] = True
    np.testing.assert_allclose(align_rigid(moved, truth, alone)[:, 3], truth[:, 3], atol=1e-9)


def test_bones_of_several_short_poses_are_resized_one_by_one():
    rng = np.random.default_rng(6)
    points = (0.1 * rng.normal(size=(4, 3, 3))).astype(np.float32)
    lengths = rng.uniform(0.2, 0.5, (4, 2))
    resized = resize_bones(points, lengths, ((0, 1), (1, 2)))
    assert resized.dtype == np.float64
    for k in range(2):
        bone, before = resized[:, k + 1] - resized[:, k], points[:, k + 1] - points[:, k]
        np.testing.assert_allclose(np.linalg.norm(bone, axis=1), lengths[:, k], rtol=1e-6)
        np.testing.assert_allclose(
            bone / lengths[:, k, None],
            before / np.linalg.norm(before, axis=1, keepdims=True), atol=1e-6,
        )  # fmt: skip


def test_single_precision_and_whole_numbers_are_fitted_in_double():
    rng = np.random.default_rng(7)
    source, target = (100.0 + rng.normal(size=(2, 5, 17, 3))).astype(np.float32)
    single = fit_similarity(source, target)
    for found, expected in zip(
        single, fit_similarity(source.astype(float), target.astype(float)), strict=True
    ):
        np.testing.assert_array_equal(found, expected)
    whole = np.array([[0, 0, 0], [2, 0, 0], [2, 3, 0]])
    resized = resize_bones(whole, np.array([0.5, 1.5]), ((0, 1), (1, 2)))
    np.testing.assert_allclose(resized, [[0, 0, 0], [0.5, 0, 0], [0.5, 1.5, 0]])


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_any_batch_is_fitted_and_resized_alike(batch):
    rng = np.random.default_rng(8)
    source, target = rng.normal(size=(2, *batch, 5, 3))
    bones, lengths = ((0, 1), (1, 3)), rng.uniform(0.2, 0.5, (*batch, 2))
    resized = resize_bones(source, lengths, bones)
    for k, (parent, child) in enumerate(bones):
        bone = resized[..., child, :] - resized[..., parent, :]
        np.testing.assert_allclose(np.linalg.norm(bone, axis=-1), lengths[..., k])
    for scaled in (True, False):
        s, R, t = fit_similarity(source, target, scaled=scaled)
        assert s.shape == batch and R.shape == (*batch, 3, 3) and t.shape == (*batch, 3)
        assert scaled or (s == 1.0).all()
        aligned = align_similarity(source, target) if scaled else align_rigid(source, target)
        np.testing.assert_allclose(aligned.mean(-2), target.mean(-2))
