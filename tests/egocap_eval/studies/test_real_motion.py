"""The tracker on a simulated person doing recorded motion: another skeleton than its own."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from egocap.body.skeleton import forward
from egocap.cameras.rig_files import load_rig
from egocap.detect.synthetic import ProjectedJoints, simulate_detections
from egocap.track.tracker import Tracker
from egocap_eval.priors.takes import FPS, act_out, fit_angles
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.motion.clips.load import load_clip
from egocap_sim.truth.proportions import measure_proportions

ROOT = Path(__file__).parents[3]
MOTIONS = ROOT.parent / "shared/motions"
CLIPS = ("bvh/007_05.bvh", "npz/basketball_signal_3.npz")
FRAMES = 120

pytestmark = pytest.mark.skipif(not MOTIONS.is_dir(), reason="needs ../shared/motions")


@cache
def person():
    return make_person(5)


@cache
def joints(clip):
    return act_out(clip, load_clip(MOTIONS / clip), person()).joints_head[:FRAMES]


def errors(clip, source, hidden):
    """Mean error over the 17 joints, metres; a share of the joints is hidden in runs of frames."""
    truth = joints(clip)
    rig = load_rig(ROOT / "scenes/rigs/egorig1.toml").resized(640, 512)
    pixels, seen = (np.moveaxis(a, 0, 1) for a in rig.project(truth))
    rng = np.random.default_rng(0)
    runs = rng.random((-(-len(truth) // 10), *seen.shape[1:])) >= hidden
    visible = seen & np.repeat(runs, 10, axis=0)[: len(truth)]
    times = np.arange(len(truth)) / FPS
    projected = ProjectedJoints(pixels, visible, seen, times, (640, 512))
    result = Tracker(rig, measure_proportions(person())).track(
        simulate_detections(projected, source, rng)
    )
    return np.linalg.norm(result.joints_head - truth, axis=-1)[:, 1:].mean()


@pytest.mark.parametrize("clip", CLIPS)
def test_exact_detections_of_all_joints(clip):
    assert errors(clip, "simulated:0,occluded=keep", 0.3) < 0.010


@pytest.mark.parametrize("clip", CLIPS)
def test_two_pixels_with_hidden_joints(clip):
    assert errors(clip, "simulated:2.0", 0.3) < 0.030


def test_angles_fitted_from_all_sides_reproduce_the_joints():
    truth = joints(CLIPS[0])[:40]
    proportions = measure_proportions(person())
    fitted = forward(proportions, fit_angles(truth, proportions))
    assert np.linalg.norm(fitted - truth, axis=-1).mean() < 0.003
