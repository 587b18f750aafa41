"""Sweeps of rigs: what they refuse, what they find, and what they say."""

import numpy as np
import pytest

from egocap.body import Proportions
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.simulation import draw_poses
from egocap.skeleton import forward
from evals.rig import (
    DEFAULTS,
    Candidate,
    Motion,
    RigReport,
    Sweep,
    bound,
    make_rig,
    parse_sweep,
    run_rig,
    seen_by,
)


def test_sweeps_are_ranges():
    sweep = parse_sweep("baseline=0.1:0.5:5")
    assert sweep.name == "baseline"
    np.testing.assert_allclose(sweep.values, [0.1, 0.2, 0.3, 0.4, 0.5])
    assert parse_sweep("fov=170").values == (170.0,)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("baseline=0.5:0.1:5", "is not a range"),
        ("baseline=0.1:0.5", "is not a range"),
        ("baseline=0.1:0.5:1", "is not a range"),
        ("baseline=0.1:0.5:2.5", "is not a range"),
        ("baseline=a:b:3", "not a number"),
        ("baseline=nan:1:3", "not a finite number"),
        ("colour=1:2:3", "a sweep 'colour=1:2:3'"),
        ("baseline", "a sweep 'baseline'"),
    ],
)
def test_what_is_no_sweep_is_refused(text, why):
    with pytest.raises(InputError, match=why):
        parse_sweep(text)


def test_impossible_grids_are_refused():
    with pytest.raises(InputError, match="each measure once"):
        run_rig([parse_sweep("up=0.1"), parse_sweep("up=0.2")], sigma=2.0)
    with pytest.raises(InputError, match="2500 rigs"):
        run_rig([parse_sweep("up=0.1:0.2:50"), parse_sweep("pitch=60:90:50")], sigma=2.0)


@pytest.fixture(scope="module")
def motion():
    person = Proportions.from_lengths(1.75)
    angles = draw_poses(40, PosteriorConfig(), np.random.default_rng(0))
    return Motion("drawn", forward(person, angles), angles, person)


def test_noise_widens_the_bound_and_blindness_more(motion):
    sharp, blurred = (bound(DEFAULTS, make_rig(DEFAULTS), [motion], s) for s in (1.0, 4.0))
    assert sharp.bound_mm < blurred.bound_mm
    upwards = DEFAULTS | {"pitch": -90.0, "fov": 120.0}
    blind = bound(upwards, make_rig(upwards), [motion], 1.0)
    assert blind.seen_any < 0.3 < sharp.seen_any
    assert blind.bound_mm > 1.5 * sharp.bound_mm


def test_trunk_hides_what_is_behind_it(motion):
    rest = Motion("rest", motion.joints[:1], 0.0 * motion.angles[:1], motion.proportions)
    front = DEFAULTS | {"pitch": 0.0, "forward": 1.5, "up": -0.4, "fov": 300.0}
    person = motion.proportions
    behind = rest.angles.copy()
    # Both arms swung straight back, then looked at from in front of the chest, turned round.
    from egocap.skeleton import DOF_INDEX

    for side in ("left", "right"):
        behind[0, DOF_INDEX[f"{side}_shoulder_raise"]] = np.deg2rad(-50)
        behind[0, DOF_INDEX[f"{side}_elbow_flexion"]] = np.deg2rad(100)
    facing = make_rig(front | {"pitch": 180.0})
    open_arms = Motion("open", forward(person, rest.angles), rest.angles, person)
    hidden = Motion("hidden", forward(person, behind), behind, person)
    assert seen_by(facing, open_arms)[0, :, [4, 8]].all()  # wrists beside the body
    assert seen_by(facing, hidden)[0, :, [4, 8]].mean() < 1.0


def report_of(bounds, baselines, noise=0.0):
    rng = np.random.default_rng(1)
    candidates = tuple(
        Candidate(
            DEFAULTS | {"baseline": b}, 0.8, 0.6, v**2 + noise * rng.normal(size=60), np.full(17, v)
        )
        for v, b in zip(bounds, baselines, strict=True)
    )
    blocks = np.repeat(np.arange(10), 6)
    return RigReport(candidates, (Sweep("baseline", tuple(baselines)),), blocks, {})


def test_verdict_on_the_papers_baseline_follows_the_error_bars():
    baselines = (0.1, 0.2, 0.35, 0.5)
    assert "is confirmed" in report_of((30, 25, 20, 22), baselines).papers_claim()
    assert "is refuted" in report_of((30, 25, 20, 18), baselines).papers_claim()
    unclear = report_of((30, 25, 20, 19.99), baselines, noise=50.0)
    assert "neither confirmed nor refuted" in unclear.papers_claim()
    assert report_of((30, 25), (0.1, 0.2)).papers_claim() == ""


def test_pareto_keeps_what_no_narrower_rig_beats():
    report = report_of((30, 25, 26, 22), (0.1, 0.2, 0.35, 0.5))
    assert [c.measures["baseline"] for c in report.pareto()] == [0.1, 0.2, 0.5]
    assert report.best.measures["baseline"] == 0.5
    difference, error = report.above(report.candidates[0], report.best)
    assert difference == pytest.approx(8.0) and error == pytest.approx(0.0, abs=1e-9)
    assert "0.5 m" in report.recommendation()
