"""Errors drawn by a known law: the model finds it, undoes it, and weighs their correlation."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.data.detections import Detections
from egocap.errors import FileError
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.detector_error import learn_detector_error, load_detector_error

FRAMES = 4000
PRIOR = 1e-6 * np.eye(37)


def draw(shared=0.0, seed=0):
    """Detections and truth: t errors of 4 degrees, doubled where unsure."""
    rng = np.random.default_rng(seed)
    shape = (FRAMES, 2, 18)
    normal = rng.standard_normal((*shape, 2))
    common = rng.standard_normal((FRAMES, 1, 18, 2))
    normal = np.sqrt(1 - shared) * normal + np.sqrt(shared) * common
    mixing = shape if shared == 0.0 else (FRAMES, 1, 18)
    noise = normal / np.sqrt(rng.chisquare(4.0, mixing) / 2.0)[..., None]  # of unit variance
    confidence = np.where(rng.random(shape) < 0.3, 0.05, 0.95)
    noise *= np.where(confidence < 0.5, 2.0, 1.0)[..., None]
    truth, sigma = rng.uniform(0, 600, (*shape, 2)), rng.uniform(1, 4, shape)
    found = Detections(
        np.arange(FRAMES) / 30, truth + sigma[..., None] * noise, sigma, confidence,
        np.ones(shape, bool), "learned:test",
    )  # fmt: skip
    return found, truth


def sensitivity(same):
    """Every angle moves one label along one axis: alike in both views, or only in one."""
    A = np.zeros((1, 2, 18, 2, 37))
    for d in range(36):
        for v in range(2) if same else (0,):
            A[0, v, d // 2, d % 2, d] = 1.0
    return A


@pytest.fixture(scope="module")
def model():
    return learn_detector_error(*([x] for x in draw()), sensitivity(True), PRIOR)


def test_law_of_the_errors_is_found(model):
    assert model.degrees == 4.0 and model.detector == "learned:test" and model.frames == FRAMES
    assert model.factors[0] == pytest.approx(2.0, rel=0.1)
    assert model.factors[-1] == pytest.approx(1.0, rel=0.1)
    assert model.temperature == pytest.approx(1.0, abs=0.05) and abs(model.memory) < 0.05


@pytest.mark.parametrize("views", [1, 4])
def test_law_is_found_of_any_number_of_views(model, views):
    found, truth = draw()
    names = ("points", "sigma", "confidence", "valid")
    four = {name: np.tile(getattr(found, name), (1, 2, 1, 1)[: getattr(found, name).ndim])
            for name in names}  # fmt: skip
    part = replace(found, **{name: array[:, :views] for name, array in four.items()})
    moves = np.tile(sensitivity(True), (1, 2, 1, 1, 1))[:, :views]
    other = learn_detector_error([part], [np.tile(truth, (1, 2, 1, 1))[:, :views]], moves, PRIOR)
    assert other.degrees == model.degrees
    assert other.factors[0] == pytest.approx(model.factors[0], rel=0.05)


def test_corrected_detections_have_their_stated_spread(model):
    found, truth = draw(seed=1)
    better = model.correct(found)
    away = (better.points - truth) / better.sigma[..., None]
    squared = np.sum(away**2, axis=-1)
    for part in (found.confidence < 0.5, found.confidence > 0.5):
        # The median squared length of a plane t of 4 degrees and unit variances: 2 (sqrt 2 - 1).
        assert np.median(squared[part]) == pytest.approx(2 * (np.sqrt(2) - 1), rel=0.1)


def test_temperature_is_the_variance_that_shared_errors_add():
    """Twice the same error in both views carries half of the information."""
    made = [[x] for x in draw(shared=1.0)]
    both = learn_detector_error(*made, sensitivity(True), PRIOR).temperature
    one = learn_detector_error(*made, sensitivity(False), PRIOR).temperature
    assert both == pytest.approx(1.0 + 0.9, abs=0.15)  # correlations are shrunk by a tenth
    assert one == pytest.approx(1.0, abs=0.05)


def test_memory_is_the_correlation_of_successive_frames():
    found, truth = draw()
    off = (found.points - truth)[:1] / found.sigma[:1, ..., None] * found.sigma[..., None]
    still = replace(found, points=truth + off, confidence=np.full(found.sigma.shape, 0.95))
    assert learn_detector_error([still], [truth], sensitivity(True), PRIOR).memory > 0.95


def test_file_keeps_the_model_and_refuses_others(model, tmp_path):
    model.save(tmp_path / "model.json")
    assert load_detector_error(tmp_path / "model.json") == model
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(FileError, match="kind"):
        load_detector_error(tmp_path / "other.json")


def test_shipped_model_sets_tails_and_temperature():
    shipped = load_detector_error()
    config = shipped.configure(PosteriorConfig(pixel_floor=0.7))
    assert config.degrees == shipped.degrees > 2.0
    assert config.temperature == shipped.temperature >= 1.0 and config.pixel_floor == 0.7
