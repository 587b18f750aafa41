"""Motion, head poses and contacts solved together, on a standing person whose truth is known."""

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, forward
from egocap.data.head_pose import HeadPoses
from egocap.geometry import rigid, transform, unit
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import make_model
from egocap.pose.motion_prior import NO_MOTION_PREDICTION, MotionPrediction
from egocap.pose.observations import Observations, tangent_basis
from egocap.track.smoother import interval_system, smooth_interval
from egocap.track.uncertainty import interval_covariances
from egocap.track.world_solver import WorldSolver
from egocap.world.foot_points import SOLE_M, STATE, FootPoints
from egocap.world.ground import Footholds, Ground

FRAMES = 24
PERSON, CONFIG = Proportions.from_lengths(1.75), TrackerConfig(lambda_motion=0.0)
MODEL, FEET = make_model(PERSON, CONFIG), FootPoints.of(PERSON)
SPREAD = 0.01  # rad


def standing(seed=0):
    """Noisy rays to a person at rest, its true joints, and its head poses: soles at z = 0.2."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0.3, 0.15, 0.0], [0.3, -0.15, 0.0]])
    joints = forward(PERSON, np.zeros(DOF_COUNT))
    rays = np.tile(unit(joints - centres[:, None]), (FRAMES, 1, 1, 1))
    rays = unit(rays + SPREAD * rng.normal(size=rays.shape))
    seen = Observations(np.arange(FRAMES) / 30, centres, rays, tangent_basis(rays) / SPREAD,
                        np.ones(rays.shape[:3]))  # fmt: skip
    sole = FEET.in_head(np.zeros((1, DOF_COUNT)))[0][0, :, 2].mean() - SOLE_M
    T = rigid(np.broadcast_to(np.eye(3), (FRAMES, 3, 3)),
              np.tile([1.0, 2.0, 0.2 - sole], (FRAMES, 1)))  # fmt: skip
    angles, _ = smooth_interval(np.zeros((FRAMES, DOF_COUNT)), seen, MODEL, CONFIG)
    return seen, joints, T, angles


def solver_of(T, known=None, floor_std=None):
    """The solver of a standing person whose head poses are these."""
    heads = HeadPoses(T, np.ones(FRAMES, bool) if known is None else known, floor_std)
    return WorldSolver(PERSON, MODEL, CONFIG, standing()[0], NO_MOTION_PREDICTION, heads)


def solved(known=None, contacts=1.0, speed=0.0, lifted=0.0, floor_std=None):
    seen, joints, T, angles = standing()
    T = T.copy()
    T[:, 2, 3] += lifted
    T[:, 0, 3] += speed * seen.times
    known = np.ones(FRAMES, bool) if known is None else known
    solver = solver_of(T, known, floor_std)
    probable = np.where(known[:, None], contacts, 0.0) * np.ones((FRAMES, 4))
    spread = np.full((FRAMES, 4), 0.06)
    return solver.solve(angles, probable, spread), joints, T, angles


def world_points(angles, T):
    return transform(T, FEET.in_head(angles)[0])


def ways(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=-1).max(1)


def test_planted_feet_keep_their_place_and_the_body_gets_no_worse():
    found, joints, T, angles = solved()
    before, after = world_points(angles, T), world_points(found.angles, found.T_world_head)
    assert ways(before).max() > 3e-3
    assert ways(after).max() < 0.1 * ways(before).max()
    errors = [np.linalg.norm(forward(PERSON, a) - joints, axis=-1)[:, [13, 17]].mean()
              for a in (angles, found.angles)]  # fmt: skip
    assert errors[1] < errors[0]
    assert abs(found.ground.level - 0.2) < 0.01
    assert (found.ground.height(after[..., :2]) - after[..., 2] + SOLE_M).max() < 2e-3


@pytest.mark.parametrize(("off", "expected"), [(-0.1, 0.0), (0.6, 0.6)])
def test_feet_are_on_a_known_floor_or_well_above_it(off, expected):
    """A tenth of a metre is less than two standard deviations; 0.6 m is another floor."""
    found, *_ = solved(lifted=off - 0.2, floor_std=0.003)
    soles = world_points(found.angles, found.T_world_head)[..., 2] - SOLE_M
    assert found.ground.level == pytest.approx(expected, abs=0.01)
    assert soles.mean() == pytest.approx(expected, abs=0.02)
    unknown, *_ = solved(lifted=off - 0.2)
    assert unknown.ground.level == pytest.approx(off, abs=0.01)


def test_feet_on_pedals_are_not_held_back():
    """Whoever rides at 5 m/s does not stand, however probable the contacts look."""
    found, joints, T, angles = solved(speed=5.0)
    errors = [np.linalg.norm(forward(PERSON, a) - joints, axis=-1).mean()
              for a in (angles, found.angles)]  # fmt: skip
    assert errors[1] < 1.1 * errors[0]
    assert np.linalg.norm((found.T_world_head - T)[:, :3, 3], axis=-1).max() < 2e-3


def test_without_contacts_it_is_the_same_problem():
    found, _, T, angles = solved(contacts=0.0)
    seen = standing()[0]
    energies = [interval_system(a, seen, MODEL, CONFIG)[0] for a in (angles, found.angles)]
    assert energies[1] <= energies[0] + 1e-9
    assert np.allclose(found.T_world_head, T, atol=1e-9)


def test_a_gap_is_left_in_the_head_frame():
    known = np.ones(FRAMES, bool)
    known[8:14] = False
    found, _, T, _ = solved(known)
    assert np.array_equal(found.T_world_head[~known], T[~known])
    points = world_points(found.angles, found.T_world_head)
    assert ways(points)[15:].max() < 0.3 * ways(points)[8:13].max()


def test_contacts_make_the_feet_more_certain():
    seen, _, T, _ = standing()
    knees = [DOF_INDEX["left_knee_flexion"], DOF_INDEX["right_knee_flexion"]]
    one, other = (
        solver_of(T).covariances(found, seen, NO_MOTION_PREDICTION)[:, knees, knees].mean()
        for found in (solved()[0], solved(contacts=0.0)[0])
    )
    assert one < other


def test_covariances_take_the_prediction_of_independent_frames():
    seen, _, T, angles = standing()
    precision = np.tile(1e4 * np.eye(DOF_COUNT), (FRAMES, 1, 1))
    prediction = MotionPrediction(angles, precision)
    separate = MotionPrediction(angles, 0.04 * precision)
    config = TrackerConfig()
    heads = HeadPoses(T, np.ones(FRAMES, bool))
    solver = WorldSolver(PERSON, MODEL, config, seen, prediction, heads)
    none = np.zeros((FRAMES, 4))
    found = solver.solve(angles, none, none)
    expected = interval_covariances(found.angles, seen, MODEL, config, separate)
    assert np.allclose(solver.covariances(found, seen, separate), expected, rtol=1e-6)


def on_ground(foothold_m, height, floor_std=0.003):
    """What points at heights over one foothold are told: probability of a contact, firmness."""
    solver = solver_of(standing()[2], floor_std=floor_std)
    places = np.array([[0.0, 0.0, foothold_m]])
    ground = Ground.learn(Footholds(places, np.ones(1), np.full(1, 0.02)))
    points = np.tile([0.0, 0.0, foothold_m + height + SOLE_M], (1, 4, 1))
    contact, firm = solver._on_ground(points, ground, np.full((1, 4), 0.9), np.full((1, 4), 0.02))
    return contact[0, 0], firm[0, 0]


def test_a_point_seen_above_the_ground_does_not_stand():
    assert on_ground(0.0, 0.0) == pytest.approx((0.9, 1.0))
    contact, firm = on_ground(0.0, 0.15)
    assert contact < 0.01 and firm == 1.0


def test_ground_that_a_point_is_seen_below_is_not_there_unless_it_is_the_floor():
    contact, firm = on_ground(0.6, -0.3)  # a rung above
    assert contact < 0.01 and firm < 0.01
    assert on_ground(0.0, -0.3)[1] == 1.0
    assert on_ground(0.0, -0.3, floor_std=None)[1] < 0.01


def test_certain_contacts_stay_finite():
    found, *_ = solved(contacts=1.0, lifted=5.0, floor_std=0.003)
    assert np.isfinite(found.angles).all() and np.isfinite(found.contacts).all()


def test_a_foot_that_slides_fast_is_let_go():
    """At 4 m/s the last round holds a planted point with less than a tenth of its weight."""
    seen, _, T, _ = standing()
    sliding = T.copy()
    sliding[:, 0, 3] += 4.0 * seen.times
    state, full = np.zeros((FRAMES, STATE)), np.ones((FRAMES, 4))
    loose, firm = (
        solver_of(poses)._terms(state, FEET, full, 0.01 * full, full, 0.03)[1].slide
        for poses in (sliding, T)
    )
    assert (loose < 0.1 * firm).all()
