"""Sweeps of rigs: what they refuse, what they find, and what they say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.errors import InputError
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.synthetic_pose import draw_poses
from egocap_eval.cli import main
from egocap_eval.rig_design import rig as rig_study
from egocap_eval.rig_design.rig import run_rig, study
from egocap_eval.rig_design.rig_bounds import bound, track_errors
from egocap_eval.rig_design.rig_plots import save_together, write_rig_page
from egocap_eval.rig_design.rig_report import Candidate, RigReport, Tracked, difference_mm
from egocap_eval.rig_design.rig_suite import Motion, SuiteVisibility
from egocap_eval.rig_design.rig_sweep import DEFAULTS, Sweep, make_rig, parse_sweep


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


class Wall:
    """Hides every joint from places left of the head."""

    def shown(self, bodies, places):
        return np.broadcast_to((places[:, 1] <= 0.0)[None, :, None], (len(bodies), len(places), 18))


def test_sights_are_by_place_and_by_lens(motion):
    bodies = np.zeros((len(motion.joints), 21, 4, 4))
    walled = replace(motion, bodies=bodies, rays=Wall())
    wide, narrow = (make_rig(DEFAULTS | {"fov": fov}) for fov in (180.0, 60.0))
    visibility = SuiteVisibility.of(
        [walled], [wide, narrow, make_rig(DEFAULTS | {"baseline": 0.1})]
    )
    assert len(visibility.places) == 4  # the lens makes no new place
    seen, less = visibility.seen(wide, 0), visibility.seen(narrow, 0)
    left = [mount.T_head_camera[1, 3] > 0.0 for mount in wide.mounts]
    assert sum(left) == 1 and not seen[:, left].any()
    right = np.logical_not(left)
    in_view = np.moveaxis(wide.project(motion.joints)[1], 0, 1)
    np.testing.assert_array_equal(seen[:, right], in_view[:, right])
    assert 0 < less.sum() < seen.sum()


def test_noise_widens_the_bound_and_blindness_more(motion):
    upwards = DEFAULTS | {"pitch": -90.0, "fov": 120.0}
    visibility = SuiteVisibility.of([motion], [make_rig(DEFAULTS), make_rig(upwards)])
    sharp, blurred = (bound(DEFAULTS, make_rig(DEFAULTS), visibility, s) for s in (1.0, 4.0))
    assert sharp.bound_mm < blurred.bound_mm
    blind = bound(upwards, make_rig(upwards), visibility, 1.0)
    assert blind.seen_any < 0.3 < sharp.seen_any
    assert blind.bound_mm > 1.5 * sharp.bound_mm


TRACK_KEYS = ("smoothed", "smoothed_seen", "posterior", "mode", "tracked", "tracked_seen")


def report_of(bounds, baselines, noise=0.0, errors=()):
    rng = np.random.default_rng(1)
    candidates = [
        Candidate(
            DEFAULTS | {"baseline": b}, 0.8, 0.6, v**2 + noise * rng.normal(size=60), np.full(17, v)
        )
        for v, b in zip(bounds, baselines, strict=True)
    ]
    for i, error in enumerate(errors):
        rms = {f"{key}_mm": error for key in TRACK_KEYS}
        candidates[i] = replace(candidates[i], tracked=Tracked(rms, np.full(30, error**2)))
    blocks = np.repeat(np.arange(10), 6)
    sweep = Sweep("baseline", tuple(baselines))
    return RigReport(tuple(candidates), (sweep,), blocks, {}, np.repeat(np.arange(5), 6))


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


def test_words_and_pictures_speak_of_tracked_rigs(tmp_path):
    report = report_of((30, 25, 20, 22), (0.1, 0.2, 0.35, 0.5), errors=(35.0, 31.0, 28.0, 27.9))
    words = report.recommendation()
    assert "Tracked: the lowest error is 27.9 mm with baseline 0.5 m" in words
    assert "the narrowest with baseline 0.35 m (28.0 mm)" in words
    assert "is refuted by the tracker's error: 28.0 mm at 0.35 m" in words
    assert len(report.to_table().rows) == 4
    write_rig_page(tmp_path / "rigs.html", report)
    save_together(tmp_path / "new" / "rigs.png", report)
    assert (tmp_path / "new" / "rigs.png").read_bytes().startswith(b"\x89PNG")
    html = (tmp_path / "rigs.html").read_text()
    assert html.count("data:image/png") == 2 and "is refuted" in html


def test_difference_of_root_mean_squares_knows_its_error():
    rng = np.random.default_rng(0)
    blocks = np.repeat(np.arange(400), 5)
    steady = np.full(2000, 100.0)
    shaken = 144.0 + np.repeat(rng.normal(0.0, 10.0, 400), 5)
    difference, error = difference_mm(shaken, steady, blocks)
    assert difference == pytest.approx(2.0, abs=0.1)
    # d(sqrt m) = dm / (a + b): 10 / sqrt(400) / 22.
    assert error == pytest.approx(0.5 / 22.0, rel=0.1)


def test_tracker_stays_near_the_bound_of_a_still_pose(motion):
    still = replace(
        motion, joints=np.repeat(motion.joints[:1], 12, 0),
        angles=np.repeat(motion.angles[:1], 12, 0),
    )  # fmt: skip
    told = track_errors(
        make_rig(DEFAULTS), SuiteVisibility.of([still], [make_rig(DEFAULTS)]), 1.0, 0
    )
    assert set(told.rms_mm) == {f"{key}_mm" for key in TRACK_KEYS}
    assert len(told.squared_mm2) == 12
    assert told.error_mm == pytest.approx(told.rms_mm["tracked_mm"])
    assert 0.0 < told.rms_mm["smoothed_mm"] < told.rms_mm["posterior_mm"]


@pytest.mark.parametrize(
    "words",
    [
        ["--sweep", "baseline=0.1:0.4:2", "fov=180"],
        ["--sweep", "baseline=0.1:0.4:2", "--sweep", "fov=180"],
    ],
)
def test_sweeps_come_after_one_flag_or_several(words, motion, monkeypatch, capsys):
    monkeypatch.setattr(rig_study, "load_suite", lambda names, frames: [motion])
    assert main(["rig", *words]) == 0
    assert "baseline" in (told := capsys.readouterr().out) and "180" in told


def test_a_sweep_without_measures_is_refused():
    with pytest.raises(InputError, match="--sweep without a measure"):
        study(sweep=((),))
    with pytest.raises(InputError, match="with --tracked"):
        study(figure=Path("rigs.png"))
