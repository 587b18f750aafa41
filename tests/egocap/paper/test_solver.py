"""The paper's energy against its formulas, and its solvers on rendered footage."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import LIMITS, SPREAD, forward
from egocap.data.sequence import Sequence
from egocap.detect.sources import synthetic_detections
from egocap.errors import InputError
from egocap.image_model.colour_measure import PAPER
from egocap.image_model.image_rays import image_rays
from egocap.image_model.model import ImageModel
from egocap.paper.config import REFERENCE, STOCHASTIC, PaperConfig
from egocap.paper.energy import detection_agreement, pose_prior, smoothness
from egocap.paper.solver import Frame, PaperSolver
from egocap.paper.tracker import PaperTracker, make_tracker
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import limit_energy, pseudo_huber
from egocap.pose.kernel import make_model
from egocap.pose.observations import observe

SMALL = replace(REFERENCE, size=(32, 32), iterations=40)


@pytest.fixture(scope="module")
def problem(motion):
    """A frame of a made-up motion before grey pictures, its solver, and the pose in it."""
    found = motion.detect("simulated:1")
    seen = observe(found, motion.rig, motion.person, TrackerConfig())
    body = GaussianBody.from_proportions(motion.person)
    image = ImageModel(body, image_rays(motion.rig, 32, 32), measure=PAPER, threads=1)
    grey = image.colours([np.full((32, 32, 3), 128, np.uint8)] * 2)
    weights = np.where(seen.weights[40] > 0.0, found.confidence[40], 0.0)
    pose = motion.angles[40] + 0.05 * SPREAD
    frame = Frame(grey, seen.centres, seen.rays[40], weights, pose + 0.1)
    return motion, image, frame, pose


def test_terms_are_those_of_the_formulas(problem):
    motion, _, frame, pose = problem
    model = make_model(motion.person, TrackerConfig())
    beyond = pose + 0.8 * (LIMITS[:, 1] - pose) * (np.arange(37) % 3 == 0) * 1.5
    joints = forward(motion.person, beyond)
    away = joints - frame.centres[:, None]
    along = (away * frame.rays).sum(-1, keepdims=True)
    off = np.linalg.norm(away - np.maximum(along, 0.0) * frame.rays, axis=-1)
    expected = -np.sum(frame.confidence / 3 * np.exp(-0.5 * (off / 0.1) ** 2))
    data = frame.centres, frame.rays, frame.confidence / 3, 0.1
    sums = [np.zeros(37) for _ in range(3)]
    assert detection_agreement(model, beyond, *data, sums[0]) == pytest.approx(expected)
    prior = limit_energy(beyond, 0.1) + 1e-4 * pseudo_huber(beyond).sum()
    assert limit_energy(beyond, 0.1) > 0.0
    assert pose_prior(model, beyond, 1e-4, 0.1, sums[1]) == pytest.approx(prior)
    smooth = 0.1 * pseudo_huber(frame.predicted - beyond).sum()
    assert smoothness(beyond, frame.predicted, 0.1, sums[2]) == pytest.approx(smooth)
    functions = (
        lambda p, g: detection_agreement(model, p, *data, g),
        lambda p, g: pose_prior(model, p, 1e-4, 0.1, g),
        lambda p, g: smoothness(p, frame.predicted, 0.1, g),
    )
    for term, slope in zip(functions, sums, strict=True):
        nudges = 1e-6 * np.eye(37)
        ends = [[term(beyond + s * n, np.zeros(37)) for n in nudges] for s in (1.0, -1.0)]
        measured = (np.array(ends[0]) - np.array(ends[1])) / 2e-6
        np.testing.assert_allclose(slope, measured, atol=1e-7)


def test_agreement_is_greatest_where_detected(problem):
    motion, _, frame, _ = problem
    model, g = make_model(motion.person, TrackerConfig()), np.zeros(37)
    centres = frame.centres
    exact = forward(motion.person, motion.angles[40])[None] - centres[:, None]
    rays = exact / np.linalg.norm(exact, axis=-1, keepdims=True)
    at = detection_agreement(model, motion.angles[40], centres, rays, np.ones((2, 18)), 0.1, g)
    assert at == pytest.approx(-36.0)
    np.testing.assert_allclose(g, 0.0, atol=1e-9)


def test_two_hundred_steps_lower_the_energy(problem):
    _, image, frame, pose = problem
    solver = PaperSolver(image, make_model(image.body.proportions, TrackerConfig()), SMALL)
    found = solver.solve(frame, pose + 0.15 * SPREAD, np.random.default_rng(0))
    assert found.energy < found.first_energy - 0.1
    assert solver.terms(frame, found.angles).sum() == pytest.approx(found.energy)


def test_a_term_of_weight_nothing_is_left_out(problem):
    motion, image, frame, pose = problem
    model = make_model(motion.person, TrackerConfig())
    off = {f"lambda_{n}": 0.0 for n in ("colour", "detection", "pose", "limit", "smooth")}
    solver = PaperSolver(image, model, replace(SMALL, **off))
    np.testing.assert_array_equal(solver.terms(frame, pose), 0.0)
    np.testing.assert_array_equal(solver.solve(frame, pose, np.random.default_rng(0)).angles, pose)


@pytest.fixture(scope="module")
def rendered(tiny_sequence):
    sequence = Sequence(tiny_sequence)
    return sequence, synthetic_detections(sequence, 1.0)


def errors(track_found, sequence):
    return np.linalg.norm(track_found.joints_head - sequence.truth.joints_head, axis=-1)[:, 1:]


@pytest.mark.parametrize("config", [SMALL, replace(STOCHASTIC, size=(32, 32), rays=300)])
def test_a_rendered_clip_is_tracked(rendered, config):
    sequence, found = rendered
    made = PaperTracker(sequence.rig, sequence.body, config).track(
        found, lambda t: sequence.frame(t).images
    )
    assert np.median(errors(made, sequence)) < 0.05
    assert made.energies is not None and (made.energies[:, 0] < -2.0).all()
    assert set(made.config["seconds"]) == {"personalise", "images", "frames", "energies"}
    assert made.seconds_per_frame == pytest.approx(made.config["seconds"]["frames"] / 7)


def test_the_same_seed_gives_the_same_track(rendered):
    sequence, found = rendered
    config = replace(STOCHASTIC, size=(32, 32), rays=100, iterations=5)
    first, again, other = (
        PaperTracker(sequence.rig, sequence.body, config, seed=seed)
        .track(found, sequence.images)
        .angles
        for seed in (0, 0, 1)
    )
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_what_the_paper_has_not_is_refused(motion):
    found = motion.detect("simulated:2")
    with pytest.raises(InputError, match="without images"):
        make_tracker(motion.rig, motion.person, "reference").track(found)
    with pytest.raises(InputError, match="use_modes = False with solver 'stochastic'"):
        make_tracker(motion.rig, motion.person, "stochastic", TrackerConfig(use_modes=False))
    with pytest.raises(InputError, match="solver 'newton'"):
        make_tracker(motion.rig, motion.person, "newton")
    for wrong in ({"keep": 2.0}, {"iterations": 0}, {"size": (4, 4)}, {"lambda_pose": -1.0}):
        with pytest.raises(InputError):
            PaperConfig(**wrong)
