from __future__ import annotations

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion import MOTIONS, make_motion
from egocap_sim.motion.clips.cleaning import despike, longest_take, repair_beyond_limits, to_local
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.balance import centre_of_mass
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.limbs import bend_angle


def soles(clip: Clip) -> np.ndarray:
    """Heel, ball and toe tip of both feet, (T, 6, 3)."""
    points = []
    for s in ("l_", "r_"):
        for part, offset in (("foot", figure.SOLE_HEEL), ("toe", [0, 0, -0.021]),
                             ("toe", figure.SOLE_TIP)):  # fmt: skip
            b = INDEX[s + part]
            points.append(clip.positions[:, b] + clip.rotations[:, b] @ np.asarray(offset))
    return np.stack(points, 1)


@pytest.fixture(scope="module", params=list(MOTIONS))
def made(request) -> Clip:
    return make_motion(request.param, 9.0, np.random.default_rng(17))


def test_shape_and_rotations(made: Clip) -> None:
    assert made.canonical and made.fps == 60.0
    R = made.rotations
    assert R.shape == (541, 21, 3, 3) and made.positions.shape == (541, 21, 3)
    np.testing.assert_allclose(
        R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9
    )
    assert np.linalg.det(R).min() > 0.999
    np.testing.assert_allclose(figure.positions(R, made.positions[:, 0]), made.positions, atol=1e-9)


def _needs_floor(made: Clip) -> None:
    if MOTIONS[made.name].mounted:
        pytest.skip("the feet are on pedals")


def test_feet_never_sink_and_one_is_always_planted(made: Clip) -> None:
    _needs_floor(made)
    p = soles(made)
    assert p[..., 2].min() > -1e-3
    down = (p[1:, :, 2] < 4e-3) & (p[:-1, :, 2] < 4e-3)
    speed = np.linalg.norm(np.diff(p, axis=0)[..., :2], axis=-1) * made.fps
    assert np.where(down, speed, np.inf).min(1).max() < 0.02


def test_planted_toes_do_not_slide(made: Clip) -> None:
    _needs_floor(made)
    for side in (slice(0, 3), slice(3, 6)):
        p = soles(made)[:, side]
        flat = (p[:, :, 2] < 5e-5).all(1)
        both = flat[1:] & flat[:-1]
        speed = np.linalg.norm(np.diff(p, axis=0)[..., :2], axis=-1).max(1) * made.fps
        assert both.any() and speed[both].max() < 0.01


def test_joints_move_as_people_can(made: Clip) -> None:
    for repair in (despike, longest_take, repair_beyond_limits):
        assert repair(made)[1] == 0
    R = to_local(made.rotations)
    step = np.swapaxes(R[:-1], -1, -2) @ R[1:]
    speed = np.arccos(np.clip((np.trace(step, axis1=-2, axis2=-1) - 1) / 2, -1, 1)) * made.fps
    assert speed.max() < 15.0
    jump = (
        np.linalg.norm(np.diff(made.positions, 2, axis=0), axis=-1)[:, INDEX["head"]] * made.fps**2
    )
    assert jump.max() < 15.0
    for s in ("l_", "r_"):
        knee = bend_angle(
            made.rotations[:, INDEX[s + "thigh"]], made.rotations[:, INDEX[s + "calf"]]
        )
        elbow = bend_angle(
            made.rotations[:, INDEX[s + "upperarm"]], made.rotations[:, INDEX[s + "forearm"]]
        )
        deepest = 155 if made.name == "poses" else 130
        assert knee.min() > 0.0 and np.abs(np.degrees(knee)).max() < deepest
        assert np.median(elbow) < 0.0


def test_same_seed_same_motion(made: Clip) -> None:
    again = make_motion(made.name, 9.0, np.random.default_rng(17))
    other = make_motion(made.name, 9.0, np.random.default_rng(18))
    np.testing.assert_array_equal(made.rotations, again.rotations)
    assert np.abs(made.rotations - other.rotations).max() > 1e-3


@pytest.mark.parametrize("name", ["gestures", "squat", "reach_low", "idle"])
def test_standing_motions_are_balanced(name: str) -> None:
    clip = make_motion(name, 10.0, np.random.default_rng(1))
    over = centre_of_mass(clip)[:, :2] - clip.positions[
        :, [INDEX["l_foot"], INDEX["r_foot"]], :2
    ].mean(1)
    assert over[:, 0].min() > -0.04 and over[:, 0].max() < 0.10
    assert np.abs(over[:, 1]).max() < 0.08


@pytest.mark.parametrize("speed", [0.4, 0.9, 1.5])
def test_walking_speed_and_place(speed: float) -> None:
    clip = make_motion("walk", 12.0, np.random.default_rng(4), speed=speed, radius=2.0, stops=False)
    xy = clip.positions[:, 0, :2]
    along = np.linalg.norm(np.diff(xy, axis=0), axis=1).sum() / 12.0
    assert along == pytest.approx(speed, rel=0.12)
    assert np.linalg.norm(xy, axis=1).max() < 2.1
    heading = clip.rotations[:-1, INDEX["pelvis"], :2, 0]
    forward = (np.diff(xy, axis=0) * heading).sum(1) / np.linalg.norm(np.diff(xy, axis=0), axis=1)
    assert np.mean(forward) > 0.95


def test_a_walk_ends_standing() -> None:
    clip = make_motion("walk", 8.0, np.random.default_rng(0))
    assert np.linalg.norm(np.diff(clip.positions[-6:], axis=0), axis=-1).max() * clip.fps < 0.02
    feet = clip.positions[-1, [INDEX["l_foot"], INDEX["r_foot"]]]
    assert np.linalg.norm(feet[0] - feet[1]) == pytest.approx(0.19, abs=0.02)


def test_a_waving_hand_is_above_the_shoulder() -> None:
    clip = make_motion("wave", 5.0, np.random.default_rng(0), hand="left")
    p = clip.positions
    assert (p[:, INDEX["l_hand"], 2] - p[:, INDEX["l_upperarm"], 2]).max() > 0.05
    assert (p[:, INDEX["r_hand"], 2] - p[:, INDEX["r_upperarm"], 2]).max() < -0.4


def test_sitting_reaches_the_seat() -> None:
    clip = make_motion("sit", 8.0, np.random.default_rng(0), seat=0.5)
    assert clip.positions[:, 0, 2].min() == pytest.approx(0.5 + 0.115, abs=0.01)


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("fly", {}, "walk"),
        ("walk", {"sped": 1.0}, "speed"),
        ("walk", {"speed": 9.0}, "0.3 to 1.7"),
        ("walk", {"speed": float("nan")}, "0.3 to 1.7"),
        ("walk", {"speed": "fast"}, "0.3 to 1.7"),
        ("walk", {"stops": 3}, "bool"),
        ("gestures", {"kinds": ["sneeze"]}, "wave"),
        ("gestures", {"kinds": "wave"}, "list"),
        ("gestures", {"kinds": 4}, "list"),
        ("gestures", {"hand": "third"}, "left, right, any"),
        ("sequence", {"parts": ["sequence"]}, "walk"),
        ("sequence", {"parts": ["walk"] * 9}, "or fewer"),
        ("idle", {"speed": 1.0}, "none"),
        ("walk", {"fps": 50.0}, "unknown parameter 'fps'"),
        ("walk", {"name": "idle"}, "unknown parameter 'name'"),
    ],
)
def test_bad_requests_list_what_is_valid(name: str, options: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        make_motion(name, 5.0, np.random.default_rng(0), **options)


@pytest.mark.parametrize(("seconds", "fps"), [(0.0, 60.0), (float("inf"), 60.0), (5.0, 0.0)])
def test_bad_durations(seconds: float, fps: float) -> None:
    with pytest.raises(InputError, match="valid"):
        make_motion("idle", seconds, np.random.default_rng(0), fps)


@pytest.mark.parametrize("name", MOTIONS)
def test_the_shortest_motion(name: str) -> None:
    clip = make_motion(name, 0.5, np.random.default_rng(0), 30.0)
    assert np.isfinite(clip.positions).all() and len(clip.positions) == 16
