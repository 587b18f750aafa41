"""Props: balls meet palms and floor, feet and hands stay on a bicycle, invalid tables raise."""

from __future__ import annotations

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.geometry import transform
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.rng import make_rng
from egocap_sim.human.body.limb_distances import limb_points
from egocap_sim.motion.generators.ball_handling import FLIGHT_S, plan_cascade, plan_touches
from egocap_sim.motion.generators.cycling import Ride, leg_scale
from egocap_sim.motion.generators.registry import MOTIONS, make_motion, motion_parameters
from egocap_sim.motion.retarget.retarget import retarget, sample_reference
from egocap_sim.props import balls
from egocap_sim.props.bicycle import LEFT_PEDAL, RIGHT_PEDAL
from egocap_sim.props.performance import Performance
from egocap_sim.props.registry import KINDS, check_prop, make_prop
from egocap_sim.scene.config import MotionTable, ThingTable

FPS, SEED = 120.0, 4


def perform(person, name: str, seconds: float = 4.0, start_s: float = 0.0) -> Performance:
    """A motion as it is meant, without forces, at many frames a second."""
    mounted = MOTIONS[name].mounted is not None
    clip = make_motion(name, 6.0, make_rng(SEED, "motion"))
    reference = retarget(clip, person, from_origin=not mounted, grounded=not mounted)
    if mounted:
        reference = MOTIONS[name].mounted(
            reference, person, make_rng(SEED, "motion"), motion_parameters(name, {})
        )
    times = np.arange(round(seconds * FPS)) / FPS
    bodies = sample_reference(person, reference, times + start_s)
    return Performance(person, MotionTable(name=name, start_s=start_s), SEED, times, bodies)


def paths(kind: str, performance: Performance) -> list[np.ndarray]:
    made = make_prop(ThingTable(kind=kind), performance, np.random.default_rng(0))
    return [extra.skinning[:, 0, :3, 3] for extra in made]


def to_palm(performance: Performance, path: np.ndarray, radius: float) -> np.ndarray:
    """Distance of a ball's skin from each palm's, (T, 2)."""
    held = [performance.held(h, performance.palms[h].centre) for h in (0, 1)]
    return np.stack([np.linalg.norm(path - p, axis=1) - radius for p in held], 1)


@pytest.mark.parametrize("start_s", [0.0, 1.3])
def test_a_dribbled_ball_touches_the_palm_and_bounces_off_the_floor(stand_in, start_s):
    performance = perform(stand_in, "dribble", start_s=start_s)
    (path,) = paths("ball", performance)
    touching = np.abs(to_palm(performance, path, balls.BASKETBALL_R)) < 1e-3
    plan = plan_touches(make_rng(SEED, "motion"), performance.parameters, 6.0)
    for touch in plan:
        t = performance.times + start_s
        held = (t >= touch.caught) & (t < touch.pushed)
        assert touching[held, touch.hand].all()
    low = path[:, 2] - balls.BASKETBALL_R
    assert -1e-9 < low.min() < 0.03
    bounces = (np.diff(np.sign(np.diff(low))) > 0) & (low[1:-1] < 0.05)
    assert bounces.sum() >= 5
    assert np.abs(np.diff(path, axis=0)).max() * FPS < 7.0  # it never jumps


def test_a_bounce_starts_and_ends_where_the_hands_are():
    a, b = np.array([0.0, 0.0, 0.65]), np.array([0.3, 0.4, 0.72])
    t = np.linspace(0.0, FLIGHT_S, 4001)
    path = balls.bounced(a, b, t, FLIGHT_S)
    np.testing.assert_allclose(path[[0, -1]], [a, b], atol=1e-9)
    k = int(path[:, 2].argmin())
    assert path[k, 2] == pytest.approx(balls.BASKETBALL_R, abs=1e-3)
    speed = np.gradient(path[:, 2], t)
    assert -speed[k + 5] / speed[k - 5] == pytest.approx(balls.BOUNCE, abs=0.02)
    away = np.r_[20 : k - 20, k + 20 : 3980]
    np.testing.assert_allclose(np.gradient(speed, t)[away], -9.81, atol=0.05)


def test_juggled_balls_fly_freely_between_the_palms(stand_in):
    performance = perform(stand_in, "juggle")
    timing = plan_cascade(make_rng(SEED, "motion"), performance.parameters)
    flown = paths("juggling_balls", performance)
    assert len(flown) == 3
    gaps = [to_palm(performance, path, balls.JUGGLING_R) for path in flown]
    in_hand = np.stack([np.abs(gap).min(1) < 1e-3 for gap in gaps], 1)
    assert 0.5 < in_hand.sum(1).mean() < 1.5  # dwell / beat = 0.98 balls at a time
    for path, held in zip(flown, in_hand.T, strict=True):
        acceleration = np.diff(path, 2, axis=0) * FPS**2
        free = ~(held[:-2] | held[1:-1] | held[2:])
        np.testing.assert_allclose(acceleration[free], [[0, 0, -9.81]] * free.sum(), atol=1e-6)
        assert path[:, 2].max() - path[:, 2].min() > 0.3
        assert np.abs(np.diff(path, axis=0)).max() * FPS < 5.0
    assert timing.beat * 3 == pytest.approx(timing.flight + timing.dwell)


def test_feet_stay_on_the_pedals_and_hands_on_the_bar(stand_in):
    performance = perform(stand_in, "cycle")
    (bicycle,) = make_prop(ThingTable(kind="bicycle"), performance, np.random.default_rng(0))
    for i, (side, pedal) in enumerate((("l", LEFT_PEDAL), ("r", RIGHT_PEDAL))):
        foot, toe = INDEX[f"{side}_foot"], INDEX[f"{side}_toe"]
        sole = stand_in.joints[toe] - stand_in.joints[foot] - [0, 0, stand_in.joints[toe, 2]]
        T = performance.bodies[:, foot]
        gap = T[:, :3, :3] @ sole + T[:, :3, 3] - bicycle.skinning[:, pedal, :3, 3]
        assert np.linalg.norm(gap, axis=1).max() < 0.005
        bar = [m.vertices for m in bicycle.actor.meshes if m.name == "grip"]
        fork = bicycle.skinning[:, 1]
        grip = np.stack([transform(fork, v).mean(1) for v in bar])  # (2, T, 3)
        palm = performance.held(i, performance.palms[i].centre)
        nearest = np.linalg.norm(grip - palm, axis=-1).min(0)
        assert nearest.max() < 0.06
    wheels = bicycle.skinning[:, 2:4, 2, 3]
    assert wheels.min() > 0.2 and wheels.max() < 0.5


def test_ride_leans_into_curves_and_returns():
    params = motion_parameters("cycle", {})
    ride = Ride(np.random.default_rng(0), params)
    t = np.arange(0.0, 20.0, 0.02)
    T = ride.pose(t)
    assert np.hypot(*T[:, :2, 3].T).max() < 1.2 * params.ride_radius
    speed = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) / 0.02
    np.testing.assert_allclose(speed, params.ride_speed, rtol=0.01)
    inward = -T[:, :2, 3] / np.linalg.norm(T[:, :2, 3], axis=1, keepdims=True)
    assert np.median(np.einsum("ti,ti->t", T[:, :2, 2], inward)) > 0.1


def test_the_figure_is_as_long_as_itself(stand_in):
    assert leg_scale(stand_in) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("kind", ["phone", "cup", "controller", "bag"])
def test_handheld_prop_stays_in_the_hand(stand_in, kind):
    performance = perform(stand_in, "hold", seconds=2.0)
    for hand, name in enumerate(("left", "right")):
        (thing,) = make_prop(
            ThingTable(kind=kind, hand=name), performance, np.random.default_rng(0)
        )
        palm = performance.held(hand, performance.palms[hand].centre)
        gap = np.linalg.norm(thing.skinning[:, 0, :3, 3] - palm, axis=1)
        assert gap.max() < 0.05 and np.ptp(gap) < 1e-9


@pytest.mark.parametrize(("kind", "motion"), [("counter", "work"), ("desk", "idle")])
def test_no_limb_is_inside_a_table(stand_in, kind, motion):
    performance = perform(stand_in, motion)
    (thing,) = make_prop(ThingTable(kind=kind), performance, np.random.default_rng(0))
    points = limb_points(performance.bodies).reshape(-1, 3)
    for mesh in thing.actor.meshes:
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        inside = ((points > low) & (points < high)).all(1)
        assert not inside.any(), mesh.name
        assert low[0] < 1.0  # near enough to hide legs


def test_seat_is_under_the_sitting_wearer(stand_in):
    performance = perform(stand_in, "sit")
    for kind, name in (("chair", "seat"), ("sofa", "cushion")):
        (thing,) = make_prop(ThingTable(kind=kind), performance, np.random.default_rng(0))
        seat = next(m for m in thing.actor.meshes if m.name == name)
        k = performance.bodies[:, 0, 2, 3].argmin()
        pelvis = performance.bodies[k, 0, :3, 3]
        low, high = seat.vertices.min(0), seat.vertices.max(0)
        assert (low[:2] < pelvis[:2]).all() and (pelvis[:2] < high[:2]).all()
        assert 0.3 < high[2] < pelvis[2]
    with pytest.raises(InputError, match="does not sit"):
        make_prop(ThingTable(kind="sofa"), perform(stand_in, "idle"), np.random.default_rng(0))


def test_a_seat_waits_behind_a_wearer_who_sits_down_later(stand_in, caplog):
    whole, start = perform(stand_in, "sit"), perform(stand_in, "sit", seconds=0.3)
    wanted, found = (
        next(m for m in thing.actor.meshes if m.name == "cushion").vertices
        for p in (whole, start)
        for thing in make_prop(ThingTable(kind="sofa"), p, np.random.default_rng(0))
    )
    np.testing.assert_allclose(found.mean(0), wanted.mean(0), atol=0.06)
    assert "end before the wearer sits down on the sofa" in caplog.text


def test_invalid_props_raise():
    with pytest.raises(InputError, match=r"unknown kind 'elephant'.*bicycle"):
        check_prop(ThingTable(kind="elephant"), "walk")
    with pytest.raises(InputError, match="a ball needs the motion 'dribble', not 'walk'"):
        check_prop(ThingTable(kind="ball"), "walk")
    with pytest.raises(InputError, match="not held in a hand"):
        check_prop(ThingTable(kind="ball", hand="left"), "dribble")
    assert all(kind.motion is None or kind.motion in MOTIONS for kind in KINDS.values())
