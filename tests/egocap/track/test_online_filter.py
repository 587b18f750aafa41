"""The live pass: it follows, it recovers, and the two directions help each other."""

import numpy as np

from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_INDEX, LIMITS, forward
from egocap.pose import kernel
from egocap.pose.config import TrackerConfig
from egocap.pose.initial_poses import STARTS, start_poses
from egocap.pose.observations import observe
from egocap.track import online_filter

CONFIG = TrackerConfig()


def setup(motion, source, **kwargs):
    seen = observe(motion.detect(source, **kwargs), motion.rig, motion.person, CONFIG)
    return seen, kernel.make_model(motion.person, CONFIG)


def error(motion, angles):
    return np.linalg.norm(forward(motion.person, angles) - motion.joints, axis=-1)[:, 1:].mean(1)


def test_starts_are_possible_poses_and_all_different():
    poses = start_poses()
    assert poses.shape == (len(STARTS), 37)
    assert (poses >= LIMITS[:, 0] - 0.1).all() and (poses <= LIMITS[:, 1] + 0.1).all()
    assert len(np.unique(poses, axis=0)) == len(poses)
    forward_arms = poses[list(STARTS).index("arms forward")]
    assert forward_arms[DOF_INDEX["right_shoulder_raise"]] > 1


def test_a_frame_depends_on_its_past_alone(motion):
    seen, model = setup(motion, "simulated:2")
    whole, *_ = online_filter.filter_sequence(seen, model, CONFIG)
    seen.weights[30:] = 0
    cut, *_ = online_filter.filter_sequence(seen, model, CONFIG)
    assert np.array_equal(whole[:30], cut[:30])


def test_tracks_exact_detections(motion):
    seen, model = setup(motion, "simulated:0")
    angles, converged, _ = online_filter.filter_sequence(seen, model, CONFIG)
    assert converged.mean() > 0.95
    assert np.median(error(motion, angles)) < 0.01


def test_recovers_after_blindness(motion):
    seen, model = setup(motion, "simulated:1")
    seen.weights[20:45] = 0
    angles, *_ = online_filter.filter_sequence(seen, model, CONFIG)
    assert np.isfinite(angles).all()
    assert np.median(error(motion, angles)[55:]) < 0.03


def test_recovers_from_swapped_sides(motion):
    """Frames whose left and right are exchanged throw the track off only while they last."""
    seen, model = setup(motion, "simulated:1")
    swap = [LABEL_INDEX[n.replace("left", "right")] for n in LABEL_INDEX if n.startswith("left")]
    left = [LABEL_INDEX[n] for n in LABEL_INDEX if n.startswith("left")]
    for array in (seen.rays, seen.whiten, seen.weights):
        part = array[30:36].copy()
        part[:, :, left + swap] = array[30:36][:, :, swap + left]
        array[30:36] = part
    angles, *_ = online_filter.filter_sequence(seen, model, CONFIG)
    assert np.median(error(motion, angles)[45:]) < 0.03


def test_two_directions_are_no_worse_than_one(motion):
    seen, model = setup(motion, "simulated:2,outliers=0.3", hidden=0.3)
    one, *_ = online_filter.filter_sequence(seen, model, CONFIG)
    both, _ = online_filter.filter_both_ways(seen, model, CONFIG)
    energies = [online_filter.frame_energies(a, seen, model, CONFIG).sum() for a in (one, both)]
    assert energies[1] <= energies[0] + 1e-6


def test_cheapest_path_weighs_changes():
    costs = np.array([[0, 0, 5, 0, 0, 9, 9, 9], [3, 3, 3, 3, 3, 3, 3, 3]], float)
    assert online_filter.cheapest_path(costs, 0.0).tolist() == [0, 0, 1, 0, 0, 1, 1, 1]
    assert online_filter.cheapest_path(costs, 4.0).tolist() == [0, 0, 0, 0, 0, 1, 1, 1]
    assert online_filter.cheapest_path(costs, 100.0).tolist() == [1] * 8


def test_cheapest_path_against_brute_force():
    from itertools import product

    costs = np.random.default_rng(0).random((2, 8)) * 3
    totals = {
        path: costs[list(path), range(8)].sum() + 0.7 * np.count_nonzero(np.diff(path))
        for path in product((0, 1), repeat=8)
    }
    assert tuple(online_filter.cheapest_path(costs, 0.7)) == min(totals, key=totals.get)
