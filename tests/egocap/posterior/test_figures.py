"""Pictures and the page are drawn from any posterior, mixed or not; no detections are the prior."""

import re
from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import MachineError
from egocap.pose.pose_prior import load_posture
from egocap.posterior.config import PosteriorConfig, SamplerConfig
from egocap.posterior.figures import draw_reliability, draw_traces, write_page
from egocap.posterior.log_prob import make_log_posterior
from egocap.posterior.result import to_arviz
from egocap.posterior.sampler import sample
from egocap.posterior.synthetic_pose import draw_detections, draw_poses


@pytest.fixture(scope="module")
def of_prior(rig, person):
    config = PosteriorConfig(model_error_m=0.0)
    rng = np.random.default_rng(0)
    poses, seen = draw_poses(1, config, rng), np.zeros((1, 2, 18), bool)
    found = draw_detections(poses, seen, rig, person, 2.0, config, rng)
    density = make_log_posterior(found, 0, rig, person, config)
    return sample(density, SamplerConfig(effective=400), source="none")


def test_without_detections_the_draws_are_the_prior(of_prior):
    assert "the prior" in of_prior.notes[0]
    drawn = draw_poses(20_000, PosteriorConfig(), np.random.default_rng(1))
    spread = drawn.std(0)
    error = spread / np.sqrt(of_prior.effective)
    assert np.all(np.abs(of_prior.flat.mean(0) - drawn.mean(0)) < 6.0 * error)
    np.testing.assert_allclose(of_prior.flat.std(0), spread, rtol=0.12)
    assert not np.allclose(drawn.mean(0), load_posture().mean, atol=1e-3)  # the limits cut it


def test_page_holds_every_figure_and_warning(of_prior, rig, tmp_path):
    write_page(
        tmp_path / "p.html", replace(of_prior, converged=False, outcome="not <mixed>"), rig, None
    )
    html = (tmp_path / "p.html").read_text()
    assert len(re.findall("data:image/png;base64,", html)) == 4
    assert '<p class="bad">not &lt;mixed&gt;</p>' in html
    assert "what follows is the prior" in html
    assert of_prior.summary()["spread_mm"]["left_hand"] > 50.0


def test_traces_are_in_the_units_of_their_parameters(of_prior):
    names = ("scale_thighs", "left_turn_x", "left_shift_x", *of_prior.names[3:])
    slowest_first = np.arange(len(names), dtype=float)
    few = replace(of_prior, names=names, effective=slowest_first, draws=of_prior.draws[:5])
    left = draw_traces(few).axes[::2]
    assert left[0].get_title() == "5 walkers"
    for axes, i, factor, unit in zip(left, range(3), (100.0, np.rad2deg(1.0), 1e3),
                                     ("100 ln", "degrees", "mm"), strict=True):  # fmt: skip
        assert axes.get_ylabel().replace("\n", " ").endswith(f", {unit}")
        np.testing.assert_allclose(axes.lines[0].get_ydata(), factor * few.draws[0, :, i])


def test_reliability_diagram_has_every_curve():
    level = np.linspace(0.1, 0.9, 5)
    figure = draw_reliability({"before": (level, level**2, 0.01 + 0 * level)})
    assert [t.get_text() for t in figure.axes[0].get_legend().get_texts()] == [
        "calibrated", "before",
    ]  # fmt: skip


def test_arviz_is_named_when_it_is_missing(of_prior):
    try:
        data = to_arviz(of_prior)
    except MachineError as error:
        assert "egocap[posterior]" in str(error)
        return
    assert data["posterior"]["left_knee_flexion"].shape == of_prior.draws.shape[:2]
