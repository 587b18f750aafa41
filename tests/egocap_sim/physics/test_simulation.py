from dataclasses import replace

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.geometry import GRAVITY, LEFT, UP, axis_angle
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.retarget.retarget import retarget
from egocap_sim.physics.control import ControlConfig
from egocap_sim.physics.model import build_model
from egocap_sim.physics.simulation import simulate

FPS = 60.0


def reference_of(person, rotations, pelvis):
    """Retarget a motion of the standard figure."""
    positions = figure.positions(rotations, pelvis)
    return retarget(Clip("test", FPS, positions, rotations, canonical=True), person)


@pytest.fixture(scope="module")
def standing(stand_in):
    R = np.tile(np.eye(3), (121, 21, 1, 1))
    return reference_of(stand_in, R, np.tile(figure.REST[0], (121, 1)))


@pytest.fixture(scope="module")
def squat(stand_in):
    """Two squats with the arms lifted to the front."""
    bend = 0.6 * (1 - np.cos(np.linspace(0, 4 * np.pi, 181)))
    R = np.tile(np.eye(3), (181, 21, 1, 1))
    for s in ("l", "r"):
        R[:, INDEX[f"{s}_thigh"]] = axis_angle(-LEFT, bend)
        R[:, INDEX[f"{s}_calf"]] = axis_angle(LEFT, bend)
        for part in ("upperarm", "forearm", "hand"):
            R[:, INDEX[f"{s}_{part}"]] = axis_angle(-LEFT, bend)
    sink = (figure.THIGH + figure.CALF) * (1 - np.cos(bend))
    return reference_of(stand_in, R, figure.REST[0] - sink[:, None] * UP)


@pytest.fixture(scope="module")
def jump(stand_in):
    """A straight jump of 0.44 m with 0.6 s of free flight."""
    t = np.arange(121) / FPS
    height = np.where((t > 0.6) & (t < 1.2), 4.905 * (t - 0.6) * (1.2 - t), 0.0)
    R = np.tile(np.eye(3), (121, 21, 1, 1))
    return reference_of(stand_in, R, figure.REST[0] + height[:, None] * UP)


def test_floor_carries_a_standing_person(stand_in, standing):
    t = simulate(stand_in, standing)
    weight = stand_in.mass_kg * 9.81
    force = t.ground_force[15:]  # when the feet have settled
    np.testing.assert_allclose(force.sum(1)[:, 2].mean(), weight, rtol=0.03)
    np.testing.assert_allclose(force.sum(1)[:, :2].mean(0), 0.0, atol=0.01 * weight)
    np.testing.assert_allclose(force[:, 0, 2].mean(), force[:, 1, 2].mean(), rtol=0.05)
    assert t.contact[15:, [0, 2]].all()
    assert t.stats.residual_wrench_bw < 0.02
    assert t.stats.joint_error_cm < 0.5


@pytest.mark.parametrize("start_s", [0.0, 0.1, 1.0])
def test_floor_carries_the_weight_from_the_first_frame(stand_in, standing, start_s):
    t = simulate(stand_in, standing, start_s=start_s, n_frames=5)
    weight = stand_in.mass_kg * 9.81
    np.testing.assert_allclose(t.ground_force.sum(1)[:, 2], weight, rtol=0.03)
    assert np.linalg.norm(t.root_wrench[:, :3], axis=1).max() < 0.02 * weight


@pytest.mark.parametrize("start_s", [0.0, 0.1])
def test_a_motion_that_begins_at_speed_is_not_started_from_rest(stand_in, start_s):
    """The reference has too little motion before the first frame to lead in with."""
    R = np.tile(np.eye(3), (61, 21, 1, 1))
    positions = figure.positions(R, figure.REST[0] + np.linspace(0, 1, 61)[:, None] * LEFT)
    flight = retarget(Clip("test", FPS, positions, R, canonical=True), stand_in, grounded=False)
    t = simulate(stand_in, flight, fps=250, start_s=start_s, n_frames=30)
    error = t.T_world_body[::5, 0, :3, 3] - flight.root[round(start_s * 50) :][:6]
    assert np.abs(error).max() < 1e-3


def test_follows_a_squat(stand_in, squat):
    t = simulate(stand_in, squat)
    assert t.stats.joint_error_cm < 1.0
    assert t.stats.planted_foot_speed_cm_s < 1.0
    assert t.stats.penetration_max_cm < 0.5
    assert t.stats.residual_wrench_bw < 0.1
    wanted = joint_positions(stand_in.joints, squat.root, squat.rotations)
    # Reference at 50, trajectory at 30 frames a second: every fifth and every third coincide.
    error = np.linalg.norm(t.T_world_body[::3, :, :3, 3] - wanted[::5], axis=-1)
    assert np.mean(error) < 0.01


def test_nothing_touches_the_floor_in_flight(stand_in, jump):
    t = simulate(stand_in, jump, fps=60)
    flight = slice(42, 68)
    assert not t.ground_force[flight].any() and not t.contact[flight].any()
    # A ballistic flight needs no help.
    residual = np.linalg.norm(t.root_wrench[flight, :3], axis=1) / (stand_in.mass_kg * 9.81)
    assert np.median(residual) < 0.1
    landed = t.ground_force[-20:, :, 2].sum(1)
    np.testing.assert_allclose(landed, stand_in.mass_kg * 9.81, rtol=0.03)


def test_forces_and_motion_obey_newton(stand_in, squat):
    """The centre of mass accelerates as ground, residual and gravity say."""
    t = simulate(stand_in, squat, fps=250)
    model = build_model(stand_in, 0.004)
    mass, centre = model.body_mass[1:], model.body_ipos[1:]
    T = t.T_world_body
    com = (T[..., :3, :3] @ centre[..., None])[..., 0] + T[..., :3, 3]
    com = (mass[:, None] * com).sum(1) / mass.sum()
    acceleration = np.diff(com, 2, axis=0) * 250.0**2
    force = t.ground_force.sum(1) + t.root_wrench[:, :3] + mass.sum() * GRAVITY
    wanted = force[1:-1] / mass.sum()
    assert np.sqrt(np.mean((acceleration - wanted) ** 2)) < 0.05  # m/s^2
    assert np.sqrt(np.mean(wanted**2)) > 0.5


def test_same_bits_every_time(stand_in, squat):
    a, b = simulate(stand_in, squat, n_frames=40), simulate(stand_in, squat, n_frames=40)
    for name in ("T_world_body", "contact", "ground_force", "root_wrench"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name


def test_frames_fall_on_their_times(stand_in, squat):
    """The same instants at different frame rates."""
    slow, fast = simulate(stand_in, squat, fps=25), simulate(stand_in, squat, fps=100)
    gap = slow.T_world_body[:, :, :3, 3] - fast.T_world_body[::4, :, :3, 3]
    assert np.abs(gap).max() < 0.005
    head = fast.T_world_body[:, INDEX["head"], :3, 3]
    assert np.abs(np.diff(head, axis=0)).max() > 0.005  # a frame's difference would show


def test_starts_late_and_holds_the_end(stand_in, squat):
    late, whole = simulate(stand_in, squat, start_s=1.0, n_frames=10), simulate(stand_in, squat)
    gap = late.T_world_body[..., :3, 3] - whole.T_world_body[30:40, :, :3, 3]
    assert np.abs(gap).max() < 5e-4
    long = simulate(stand_in, squat, start_s=2.5, n_frames=60)
    assert len(long.T_world_body) == 60
    assert np.ptp(long.T_world_body[-20:, :, :3, 3], axis=0).max() < 0.003


def test_a_motion_that_teleports_is_refused(stand_in, squat):
    root = squat.root.copy()
    root[60:, 0] += 2.0
    with pytest.raises(InputError, match=r"jumps at 1\.18 s"):
        simulate(stand_in, replace(squat, root=root))


def test_a_simulation_that_blows_up_is_an_error(stand_in, squat, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs its warning
    with pytest.raises(InputError, match="cannot follow the motion"):
        simulate(stand_in, squat, control=ControlConfig(root_rate=float("nan")))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"fps": 0.0}, "1 to 1000"),
        ({"fps": float("nan")}, "1 to 1000"),
        ({"n_frames": 0}, "1 or more"),
        ({"start_s": -1.0}, "cannot start at"),
        ({"start_s": 99.0}, "cannot start at"),
    ],
)
def test_impossible_arguments_are_refused(stand_in, standing, arguments, says):
    with pytest.raises(InputError, match=says):
        simulate(stand_in, standing, **arguments)


def test_references_that_are_not_finite_are_refused(stand_in, standing):
    with pytest.raises(InputError, match="not finite"):
        simulate(stand_in, replace(standing, root=standing.root * np.nan))
