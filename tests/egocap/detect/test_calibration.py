"""The fit finds the temperature that was put in, and says what it cannot fit."""

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.detect.calibration import KINDS, Calibration, fit_calibration, margin, present
from egocap.errors import InputError


def said(rng, count=4000):
    """What a network would say (info), and what is true, with known faults."""
    info = rng.normal(size=(count, 18, 4))
    info[..., :3] *= 2.0
    true_margin = 0.5 * margin(info) + 0.7  # too sure by 2, and biased
    seen = rng.random((count, 18)) < 1.0 / (1.0 + np.exp(-true_margin))
    factor = np.where(seen, 3.0, 0.5)  # sigma too small for seen joints, too large for others
    sigma = np.exp(info[..., 3]) * factor
    errors = np.hypot(*rng.normal(size=(2, count, 18))) * sigma
    return info, errors, seen


def test_fit_finds_what_was_put_in():
    info, errors, seen = said(np.random.default_rng(0))
    found = fit_calibration(info, errors, seen, np.ones_like(seen))
    assert found.scale == pytest.approx(0.5, abs=0.03)
    assert found.offset == pytest.approx(0.7, abs=0.05)
    assert found.log_sigma_seen == pytest.approx(np.log(3.0), abs=0.02)
    assert found.log_sigma_hidden == pytest.approx(np.log(0.5), abs=0.02)


def test_fit_finds_what_was_put_in_for_a_kind_of_joint():
    info, errors, seen = said(np.random.default_rng(5))
    wrists = [LABELS.index(f"{side}_wrist") for side in ("left", "right")]
    errors[:, wrists] *= np.where(seen, 1.0, 2.0)[:, wrists]
    found = fit_calibration(info, errors, seen, np.ones_like(seen))
    assert set(found.kinds_hidden) == set(KINDS)
    wrist = found.log_sigma_hidden + found.kinds_hidden["wrist"]
    elbow = found.log_sigma_hidden + found.kinds_hidden["elbow"]
    assert wrist - elbow == pytest.approx(np.log(2.0), abs=0.05)
    assert max(map(abs, found.kinds_seen.values())) < 0.03
    says = Calibration(kinds_hidden={"wrist": np.log(3.0)}).sigma(
        np.array([[[0.0, 99.0, 0, 0]] * 18])
    )
    np.testing.assert_allclose(says[0], np.where(np.isin(range(18), wrists), 3.0, 1.0))


def test_few_joints_of_a_kind_change_little():
    info, errors, seen = said(np.random.default_rng(6), 400)
    in_view = np.ones_like(seen)
    in_view[5:, LABELS.index("head")] = False
    errors[:, LABELS.index("head")] *= 3.0
    found = fit_calibration(info, errors, seen & in_view, in_view)
    assert 0.0 < found.kinds_hidden["head"] < 0.2


def test_joints_out_of_view_do_not_count():
    info, errors, seen = said(np.random.default_rng(1))
    in_view = np.random.default_rng(2).random(seen.shape) < 0.7
    worse = np.where(in_view, errors, 1e6)
    inside = fit_calibration(info, errors, seen & in_view, in_view)
    assert fit_calibration(info, worse, seen & in_view, in_view) == inside


def test_joints_that_the_network_says_are_absent_do_not_count():
    """One clip, of a rig that has the head behind it, made every spread three times wider."""
    info, errors, seen = said(np.random.default_rng(2))
    worse = np.where(present(info), errors, 1e6)
    every = np.ones_like(seen)
    assert fit_calibration(info, worse, seen, every) == fit_calibration(info, errors, seen, every)


def test_confidence_is_a_probability_and_sigma_blends():
    info = np.zeros((1, 18, 4))
    info[0, 0, :3] = 9.0, 0.0, 0.0
    info[0, 1, :3] = 0.0, 9.0, 0.0
    calibration = Calibration(log_sigma_seen=np.log(2.0), log_sigma_hidden=np.log(5.0))
    confidence, sigma = calibration.confidence(info), calibration.sigma(info)
    assert confidence[0, 0] > 0.99 and confidence[0, 1] < 0.01
    assert confidence[0, 2] == pytest.approx(1.0 / 3.0)
    assert sigma[0, 0] == pytest.approx(2.0, rel=0.01)
    assert sigma[0, 1] == pytest.approx(5.0, rel=0.01)


def test_present_is_seen_or_hidden():
    info = np.zeros((3, 18, 4))
    info[0, :, 2], info[1, :, 1], info[2, :, 2] = 2.0, 2.0, 0.6  # 0.6 < log 2
    assert not present(info)[0].any()
    assert present(info)[1:].all()


def test_kinds_too_rare_to_say_are_left_alone():
    info, errors, seen = said(np.random.default_rng(3), 200)
    found = fit_calibration(info, errors, np.ones_like(seen), np.ones_like(seen))
    assert found.log_sigma_hidden == 0.0 and found.log_sigma_seen != 0.0


def test_too_little_is_refused():
    info, errors, seen = said(np.random.default_rng(4), 2)
    with pytest.raises(InputError, match="joints to calibrate on"):
        fit_calibration(info, errors, seen, np.ones_like(seen))
    with pytest.raises(InputError, match="log_sigma_seen 5"):
        Calibration(log_sigma_seen=5.0)
    with pytest.raises(InputError, match="kinds_hidden wrist 5"):
        Calibration(kinds_hidden={"wrist": 5.0})
    with pytest.raises(InputError, match="kinds_hidden 3"):
        Calibration(kinds_hidden=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="kinds_seen of 'tail'"):
        Calibration(kinds_seen={"tail": 0.0})
    with pytest.raises(InputError, match="nan"):
        Calibration(float("nan"))


def test_round_trip():
    made = Calibration(1.25, -0.5, 0.1, -0.2, {"wrist": 0.3}, {"hand": 0.4})
    assert Calibration(**made.to_dict()) == made
