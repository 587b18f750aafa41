"""Simulated detections: the name's form, the statistics of the draws, and who is dropped."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.body.labels import LABEL_INDEX
from egocap.data.sequence import Sequence
from egocap.detect.sources import detections_from, synthetic_detections
from egocap.detect.synthetic import (
    EPISODE_S,
    GUESS,
    GUESS_CONFIDENCE,
    LEARNED_LIKE,
    ProjectedJoints,
    SimulatedSource,
    parse_source,
    simulate_detections,
)
from egocap.errors import InputError

SIZE = (1280, 1024)


def scene(frames=200, seen=0.7, in_view=0.9):
    rng = np.random.default_rng(0)
    joints = 200 + rng.random((frames, 2, 18, 2)) * (880, 624)
    view = rng.random((frames, 2, 18)) < in_view
    return joints, view & (rng.random((frames, 2, 18)) < seen), view


def draw(source, seed=0, **kwargs):
    joints, visible, view = scene(**kwargs)
    times = np.arange(len(joints)) / 30
    rng = np.random.default_rng(seed)
    found = simulate_detections(ProjectedJoints(joints, visible, view, times, SIZE), source, rng)
    return found, joints, visible, view


def test_views_have_their_own_sizes():
    joints = np.full((500, 2, 18, 2), 300.0)
    joints[:, 1] += (700.0, 500.0)  # outside the first view's image
    there, sizes = np.ones((500, 2, 18), bool), np.array([(640, 512), (1280, 1024)])
    given = ProjectedJoints(joints, there, there, np.arange(500.0), sizes)
    found = simulate_detections(given, "simulated:2", np.random.default_rng(0))
    assert found.valid.all()
    assert np.allclose(found.sigma, np.array([2.0, 4.0])[:, None])
    error = (found.points - joints).std((0, 2, 3))
    assert np.allclose(error, (2.0, 4.0), rtol=0.05)


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("simulated:2.0", SimulatedSource(2.0)),
        ("simulated:0", SimulatedSource(0.0)),
        ("simulated:2,outliers=0.1", SimulatedSource(2.0, 0.1)),
        ("simulated:0,occluded=keep", SimulatedSource(0.0, 0.0, "keep")),
        ("simulated:1e0,occluded=drop,outliers=1", SimulatedSource(1.0, 1.0)),
    ],
)
def test_names_are_read(text, source):
    assert parse_source(text) == source
    assert parse_source(str(source)) == source


@pytest.mark.parametrize(
    "text",
    [
        "", "simulated", "simulated:", "simulated:two", "simulated:-1", "simulated:nan",
        "simulated:inf", "simulated:1e9", "simulated:2,", "simulated:2,outliers",
        "simulated:2,outliers=2", "simulated:2,outliers=x", "simulated:2,outliers=0.1,outliers=0.2",
        "simulated:2,occluded=hide", "simulated:2,colour=red", "network:a.pt", "Simulated:2",
    ],
)  # fmt: skip
def test_bad_names_list_the_valid_form(text):
    with pytest.raises(InputError, match="simulated:SIGMA"):
        parse_source(text)


@settings(deadline=None)
@given(st.text(max_size=30) | st.text(max_size=20).map("simulated:".__add__))
def test_any_text_is_a_source_or_an_input_error(text):
    with contextlib.suppress(InputError):
        assert parse_source(str(parse_source(text))) == parse_source(text)


def test_noise_has_the_stated_scatter_at_the_images_scale():
    found, joints, visible, _ = draw("simulated:2.0")
    assert np.array_equal(found.valid, visible)
    noise = (found.points - joints)[found.valid]
    assert len(noise) > 3000
    assert noise.std() == pytest.approx(4.0, rel=0.03)  # 1280 px wide: twice 2.0
    assert abs(noise.mean()) < 0.15
    assert np.allclose(found.sigma, 4.0)
    assert found.source == "simulated:2.0"


def test_exact_detections_of_all_joints_in_view():
    found, joints, visible, view = draw("simulated:0,occluded=keep")
    assert np.array_equal(found.valid, view)
    assert (view & ~visible).any()
    assert np.array_equal(found.points[view], joints[view])


def test_missing_detections_carry_no_values():
    found, *_ = draw("simulated:2.0")
    assert np.isnan(found.points[~found.valid]).all()
    assert (found.confidence[~found.valid] == 0).all()


def test_unseen_joints_turn_wild_at_the_stated_rate():
    found, joints, visible, _ = draw("simulated:0,outliers=0.25")
    assert np.array_equal(found.points[visible], joints[visible])
    wild = found.valid & ~visible
    assert wild.sum() / (~visible).sum() == pytest.approx(0.25, abs=0.03)
    places = found.points[wild]
    assert ((places >= -0.5) & (places <= np.array(SIZE) - 0.5)).all()
    assert places.mean(0) == pytest.approx(np.array(SIZE) / 2, rel=0.1)
    assert (found.confidence[wild] == 1).all()  # nothing gives them away


def test_outliers_of_one_leave_none_missing():
    found, *_ = draw("simulated:0,outliers=1")
    assert found.valid.all()


def test_noise_out_of_the_image_is_a_miss():
    joints = np.full((500, 1, 18, 2), 1.0)
    seen = np.ones((500, 1, 18), bool)
    source, rng = SimulatedSource(2.0), np.random.default_rng(0)
    found = simulate_detections(
        ProjectedJoints(joints, seen, seen, np.arange(500.0), SIZE), source, rng
    )
    assert 0.3 < found.valid.mean() < 0.6
    assert (found.points[found.valid] >= -0.5).all()


def test_same_seed_same_draws():
    a, b = draw("simulated:2,outliers=0.2", seed=5)[0], draw("simulated:2,outliers=0.2", seed=5)[0]
    assert np.array_equal(a.points, b.points, equal_nan=True)
    assert not np.array_equal(a.points, draw("simulated:2", seed=6)[0].points, equal_nan=True)


def still(source, frames=4000, hidden=False, seed=0):
    """Detections of joints that stand still, 18 in a row."""
    joints = np.tile(np.stack([np.linspace(100, 1100, 18), np.full(18, 500.0)], -1), (frames, 1, 1))
    joints = joints[:, None]
    view = np.ones(joints.shape[:3], bool)
    times, rng = np.arange(frames) / 30, np.random.default_rng(seed)
    visible = view & (not hidden)
    found = simulate_detections(ProjectedJoints(joints, visible, view, times, SIZE), source, rng)
    return found, joints


def test_options_left_out_draw_nothing():
    plain, marked = draw("simulated:2")[0], draw("simulated:2,tails=0,spread=0,swaps=0")[0]
    assert np.array_equal(plain.points, marked.points, equal_nan=True)
    assert plain.modes is None


def test_every_option_survives_its_name():
    text = LEARNED_LIKE
    assert parse_source(str(parse_source(text))) == parse_source(text)
    assert str(parse_source("simulated:2.0,wrong=0.1")) == "simulated:2.0,wrong=0.1"


def test_spread_says_how_wrong_each_point_is():
    found, joints = still("simulated:2,spread=0.6")
    whitened = (found.points - joints) / found.sigma[..., None]
    assert np.nanstd(whitened) == pytest.approx(1.0, abs=0.02)
    assert np.log(found.sigma).std() == pytest.approx(0.6, abs=0.02)


def test_tails_are_students():
    from scipy.stats import t

    found, joints = still("simulated:2,tails=3")
    whitened = np.sort(((found.points - joints) / found.sigma[..., None])[..., 0].ravel())
    for share in (0.1, 0.5, 0.9, 0.99):
        assert whitened[int(share * len(whitened))] == pytest.approx(t.ppf(share, 3), abs=0.2)


def test_errors_remember():
    found, joints = still("simulated:2,correlation=0.1")
    error = (found.points - joints)[:, 0, :, 0]
    alike = np.mean(error[1:] * error[:-1]) / np.mean(error**2)
    assert alike == pytest.approx(np.exp(-1 / 3), abs=0.03)


def test_overconfidence_understates_sigma():
    found, joints = still("simulated:2,overconfidence=2")
    assert np.std((found.points - joints) / found.sigma[..., None]) == pytest.approx(2, abs=0.05)


def test_guesses_of_hidden_joints_say_so():
    found, joints = still("simulated:2,occluded=guess", hidden=True)
    assert found.valid.mean() > 0.99
    assert np.nanstd(found.points - joints) == pytest.approx(2 * 2 * GUESS, rel=0.03)
    assert np.allclose(found.sigma, 2 * 2 * GUESS)
    assert (found.confidence[found.valid] == GUESS_CONFIDENCE).all()


def test_swaps_last_and_take_a_share_of_the_time():
    found, joints = still("simulated:0,swaps=0.2", frames=20000)
    swapped = (found.points != joints).any(-1)[:, 0]
    left, right = LABEL_INDEX["left_knee"], LABEL_INDEX["right_knee"]
    assert swapped[:, left].mean() == pytest.approx(0.2, abs=0.03)
    assert np.array_equal(swapped[:, left], swapped[:, LABEL_INDEX["right_foot"]])
    assert not np.array_equal(swapped[:, left], swapped[:, LABEL_INDEX["left_hand"]])
    at = np.flatnonzero(swapped[:, left])
    assert np.array_equal(found.points[at, 0, left], joints[at, 0, right])
    stretches = np.count_nonzero(np.diff(swapped[:, left].astype(int)) == 1)
    assert len(at) / stretches == pytest.approx(30 * EPISODE_S, rel=0.2)
    assert not swapped[:, :2].any()


def test_strangers_limbs_move_as_one_and_may_leave_the_true_mode():
    found, joints = still("simulated:0,wrong=0.2,modes=1")
    away = (found.points - joints)[:, 0]
    knee, foot = (LABEL_INDEX[f"left_{part}"] for part in ("knee", "foot"))
    both = found.valid[:, 0, knee] & found.valid[:, 0, foot]
    assert np.allclose(away[both, knee], away[both, foot])
    stray = both & (np.abs(away[:, knee]).max(-1) > 0)
    assert stray.mean() == pytest.approx(0.2, abs=0.06)
    distance = np.linalg.norm(away[stray, knee], axis=-1) / 2  # 1280 px wide
    assert distance.min() >= 60 and distance.max() <= 200
    places, weights = found.candidates
    assert (weights[stray, 0, knee, 1] > 0).all()
    assert np.array_equal(places[stray, 0, knee, 1], joints[stray, 0, knee])
    assert (weights[both & ~stray, 0, knee, 1] == 0).all()


def test_a_sequence_is_drawn_alike_by_either_name(tiny_sequence):
    sequence = Sequence(tiny_sequence)
    drawn = synthetic_detections(sequence, 2.0, seed=3, options="outliers=0.1,tails=3")
    named = detections_from(sequence, "simulated:2.0,outliers=0.1,tails=3", 3)
    assert drawn.source == named.source == "simulated:2.0,outliers=0.1,tails=3"
    assert np.array_equal(drawn.points, named.points, equal_nan=True)
    other = synthetic_detections(sequence, 2.0, seed=4)
    assert not np.array_equal(drawn.points, other.points, equal_nan=True)
    for bad in ({"sigma": -1.0}, {"seed": -1}, {"options": "nonsense=1"}):
        with pytest.raises(InputError):
            synthetic_detections(sequence, **bad)
