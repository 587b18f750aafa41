"""Coverage and ranks have the right distribution where the answer is known."""

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.errors import FileError, InputError
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap_eval.harness.cases import ScoreLog
from egocap_eval.posterior import calibration
from egocap_eval.posterior.calibration import (
    DrawnNoise,
    run_detector,
    run_well_specified,
    study,
)
from egocap_eval.posterior.calibration_plots import write_diagrams
from egocap_eval.posterior.coverage import (
    CalibrationReport,
    Coverage,
    FrameScore,
    rank_statistics,
    region_share,
)
from egocap_sim.core.resources import rig_file


def score(inside, ranks=None):
    zeros = np.zeros(18)
    return FrameScore(np.full(18, inside), np.full(18, inside), ranks, zeros, zeros, 1e3, 1.0, True)


def test_region_share_is_even_when_truth_and_draws_are_alike():
    rng = np.random.default_rng(0)
    shape = np.diag([1.0, 0.1, 3.0])
    shares = [
        region_share(rng.standard_normal((40, 20, 18, 3)) @ shape, truth @ shape)
        for truth in rng.standard_normal((150, 18, 3))
    ]
    for level in (0.5, 0.8, 0.95):
        assert np.mean(np.array(shares) <= level) == pytest.approx(level, abs=0.025)
    far = region_share(rng.standard_normal((40, 20, 18, 3)), np.full((18, 3), 10.0))
    assert (far == 1.0).all()


def test_coverage_counts_and_its_error_is_that_of_frames():
    coverage = Coverage("x", tuple(score(i) for i in np.linspace(0.005, 0.995, 100)))
    share, error = coverage.pooled(0.8)
    assert share == pytest.approx(0.8)
    assert error == pytest.approx(0.04, abs=0.001)  # 100 draws, though 1700 joints
    assert coverage.binomial_error(0.8) == pytest.approx(0.04)


def test_ranks_tell_a_narrow_sampler_from_a_right_one():
    rng = np.random.default_rng(0)
    right = [score(0.5, rng.integers(0, 97, 37) / 96) for _ in range(400)]
    assert rank_statistics(right)["smallest_p_of_as_many"] > 0.01
    narrow = [score(0.5, rng.beta(0.5, 0.5, 37)) for _ in range(400)]
    told = rank_statistics(narrow)
    assert told["smallest_p"] < 1e-6 and told["evenness_of_p"] < 1e-6


def test_study_runs_goes_on_and_draws(monkeypatch, tmp_path):
    monkeypatch.setattr(calibration, "SAMPLER", SamplerConfig(most_steps=500))
    rig = load_rig(rig_file("egorig1")).resized(640, 512)
    noise = DrawnNoise(sigma=2.0, missing=0.0, degrees=np.inf)
    settings = {"seed": 1, "workers": 1}
    with pytest.raises(InputError, match="1 frames"):
        run_well_specified(1, rig, noise, **settings)
    report = run_well_specified(2, rig, noise, **settings)
    told = report.to_dict()["well_specified"]
    assert told["frames"] == 2 and 0.0 <= told["levels"]["0.8"]["coverage"] <= 1.0
    assert sum(told["ranks"]["histogram"]) == 2 * 37

    kept = tmp_path / "frames.jsonl"
    log = ScoreLog(kept)
    first = run_well_specified(2, rig, noise, **settings, log=log)
    np.testing.assert_array_equal(
        first.well_specified.scores[1].inside, report.well_specified.scores[1].inside
    )
    kept.write_text(kept.read_text()[:-30])  # a kill in the middle of the last line
    monkeypatch.setattr(calibration, "score_frame", lambda job: pytest.fail("done before"))
    with pytest.raises(pytest.fail.Exception, match="done before"):
        run_well_specified(2, rig, noise, **settings, log=ScoreLog(kept))
    last = list(log._scores)[-1]
    ScoreLog(kept).add(last, log[last])
    again = run_well_specified(2, rig, noise, **settings, log=ScoreLog(kept))
    assert again.to_dict() == first.to_dict()
    write_diagrams(tmp_path / "page.html", again)
    assert (tmp_path / "page.html").read_text().count("data:image/png") == 3


def test_detector_is_scored_as_stated_and_by_its_error_model(tiny_sequence, monkeypatch):
    monkeypatch.setattr(calibration, "SAMPLER", SamplerConfig(most_steps=500))
    config = PosteriorConfig()
    with pytest.raises(InputError, match="1 sequences"):
        run_detector([tiny_sequence], "simulated:2", 2, config, 1)
    before, after, model = run_detector([tiny_sequence] * 2, "simulated:2", 2, config, 1)
    assert len(before.scores) == len(after.scores) == 2
    assert model.detector == "simulated:2.0" and model.frames == 7
    report = CalibrationReport(None, before=before, after=after, model=model)
    assert report.to_dict()["error_model"]["temperature"] >= 1.0
    assert [row[0] for row in report.to_table().rows] == ["as stated", "by the error model"]


def test_other_files_are_no_score_logs(tmp_path):
    (tmp_path / "a.jsonl").write_text('{"frame": "x"}\n{"frame": "y"}\n')
    with pytest.raises(FileError, match="holds no scores"):
        ScoreLog(tmp_path / "a.jsonl")


def test_only_detector_needs_sequences():
    with pytest.raises(InputError, match="--only-detector without sequences"):
        study(only_detector=True)
