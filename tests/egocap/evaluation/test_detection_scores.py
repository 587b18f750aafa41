import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.errors import InputError
from egocap.evaluation import evaluate_detections

WIDTHS = np.array([1280, 1280])


def views(frames=3, seed=0):
    truth = np.random.default_rng(seed).uniform(0, 1000, (frames, 2, 18, 2))
    return truth, np.ones(truth.shape[:3], bool)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_perfect_detections_score_exactly_100(frames):
    truth, everywhere = views(frames)
    score = evaluate_detections(truth, everywhere, truth, everywhere, everywhere, WIDTHS)
    assert score.pck20 == score.auc20 == score.pck20_seen == score.auc20_seen == 100
    assert set(score.per_joint_pck20.values()) == {100}
    assert score.curve["0"] == 100
    assert score.missing_share == 0 and score.median_px == 0
    assert score.counted == frames * 36


def test_hand_made_case():
    truth, everywhere = views(1)
    points, detected, in_view, seen = truth.copy(), *(everywhere.copy() for _ in range(3))
    points[0, 0, 0, 0] += 20.0  # 10 px at 640: found
    points[0, 0, 1, 1] += 42.0  # 21 px: a miss
    detected[0, 0, 2] = False  # a miss, though its point is right
    points[0, 0, 2] = np.nan
    in_view[0, 1] = False  # the whole right view does not count
    truth[0, 1] = np.nan
    seen[0, 0, 1:3] = False
    score = evaluate_detections(points, detected, truth, in_view, seen, WIDTHS, "by hand")
    assert score.counted == 18 and score.source == "by hand"
    assert score.pck20 == pytest.approx(100 * 16 / 18)
    assert score.auc20 == pytest.approx(100 * 15.5 / 18)
    assert score.pck20_seen == 100
    assert score.missing_share == pytest.approx(1 / 18)
    assert score.mean_px == pytest.approx(31 / 17)
    assert score.per_joint_pck20[LABELS[1]] == 0
    assert score.curve["10"] == pytest.approx(100 * 16 / 18)
    assert score.curve["22"] == pytest.approx(100 * 17 / 18)


def test_nothing_in_view_is_none_not_zero():
    truth, everywhere = views()
    score = evaluate_detections(truth, everywhere, truth, ~everywhere, everywhere, WIDTHS)
    assert score.pck20 is None and score.auc20 is None and score.missing_share is None


def test_nothing_detected_is_zero():
    truth, everywhere = views()
    score = evaluate_detections(truth, ~everywhere, truth, everywhere, everywhere, WIDTHS)
    assert score.pck20 == score.auc20 == 0 and score.missing_share == 1
    assert score.mean_px is None


def test_not_finite_names_frame_view_and_joint():
    truth, everywhere = views()
    points = truth.copy()
    points[2, 1, 5] = np.inf
    with pytest.raises(InputError, match="frame 2, view 1, left_hand"):
        evaluate_detections(points, everywhere, truth, everywhere, everywhere, WIDTHS)


def test_other_shapes_are_refused():
    truth, everywhere = views()
    with pytest.raises(InputError, match="detections"):
        evaluate_detections(truth[:, :1], everywhere, truth, everywhere, everywhere, WIDTHS)
    with pytest.raises(InputError, match=r"\(T, V, 18, 2\)"):
        turned = truth.swapaxes(1, 2)
        evaluate_detections(turned, everywhere, turned, everywhere, everywhere, WIDTHS)
