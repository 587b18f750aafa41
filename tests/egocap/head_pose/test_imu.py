"""Gravity, clock, axes and place of an inertial sensor against a known motion; its files."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import FileError, InputError
from egocap.geometry import GRAVITY, inverse, rigid
from egocap.head_pose.imu import vertical_by_imu
from egocap.head_pose.imu_files import Imu, read_imu
from tests.egocap.head_pose.motion import T_DEVICE_HEAD, head_motion

TIME = np.arange(900) / 30.0
OFFSET = -1.234
R_MAP_WORLD = Rotation.from_rotvec([0.5, -0.3, 1.0]).as_matrix()  # the map's axes are its own
UP = R_MAP_WORLD[:, 2]


def sensor(rng, noise=1.0, rate=200.0):
    """What a sensor at T_DEVICE_HEAD measures, from differences over a millisecond."""
    t, e = np.arange(1.0, 29.0, 1.0 / rate), 1e-3
    before, now, after = (head_motion(s) @ inverse(T_DEVICE_HEAD) for s in (t - e, t, t + e))
    turn = np.swapaxes(before[:, :3, :3], 1, 2) @ after[:, :3, :3]
    spin = Rotation.from_matrix(turn).as_rotvec() / (2 * e)
    acceleration = (before - 2 * now + after)[:, :3, 3] / e**2
    force = np.einsum("nji,nj->ni", now[:, :3, :3], acceleration - GRAVITY)
    spin += noise * (np.array([0.004, -0.006, 0.003]) + 0.003 * rng.normal(size=spin.shape))
    force += noise * (np.array([0.05, -0.04, 0.06]) + 0.03 * rng.normal(size=force.shape))
    return Imu(t - OFFSET, spin, force)


def poses(rng, noise=1.0):
    """Head poses as odometry gives them, in the map's frame."""
    T = rigid(R_MAP_WORLD, np.array([1.0, 2.0, 3.0])) @ head_motion(TIME)
    T[:, :3, 3] += noise * 1e-3 * rng.normal(size=(len(T), 3))
    return T


def degrees(up):
    return np.degrees(np.arccos(np.clip(up @ UP, -1.0, 1.0)))


def test_up_clock_axes_and_place_are_found(rng):
    found = vertical_by_imu(TIME, poses(rng, 0.0), sensor(rng, 0.0))
    assert degrees(found.vertical.up) < 0.02
    assert found.offset_s == pytest.approx(OFFSET, abs=1e-3)
    assert found.R_sensor_head == pytest.approx(T_DEVICE_HEAD[:3, :3], abs=2e-3)
    assert found.place == pytest.approx(inverse(T_DEVICE_HEAD)[:3, 3], abs=0.01)


def test_a_clock_of_days_is_found_as_well(rng):
    imu = sensor(rng)
    found = vertical_by_imu(TIME, poses(rng), Imu(imu.time + 1.7e9, imu.rate, imu.force))
    assert found.offset_s + 1.7e9 == pytest.approx(OFFSET, abs=2e-3)
    assert degrees(found.vertical.up) < 0.3


def test_stated_error_holds_with_bias_and_noise(rng):
    ratios = []
    for _ in range(8):
        found = vertical_by_imu(TIME, poses(rng), sensor(rng))
        assert degrees(found.vertical.up) < 0.3
        ratios.append(degrees(found.vertical.up) / np.degrees(found.vertical.up_std))
    assert 0.15 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_gaps_and_outliers_of_poses_do_not_tilt_it(rng):
    T = poses(rng)
    T[400:404, :3, 3] += 0.2
    kept = np.r_[0:300, 360:900]
    found = vertical_by_imu(TIME[kept], T[kept], sensor(rng))
    assert degrees(found.vertical.up) < 0.3


def test_forces_of_another_motion_are_refused(rng):
    imu = sensor(rng)
    with pytest.raises(InputError, match="do not turn alike"):
        vertical_by_imu(TIME, poses(rng), Imu(imu.time, rng.normal(size=imu.rate.shape), imu.force))
    with pytest.raises(InputError, match="half seconds in common"):
        vertical_by_imu(TIME[:60], poses(rng)[:60], sensor(rng))


HEADS = {
    "timestamp_s,gx,gy,gz,ax,ay,az": 1.0,
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]": 1e9,
    "Time_ms,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z": 1e3,
}


def written(path, head, scale, imu):
    columns = [imu.force, imu.rate] if "acc_" in head else [imu.rate, imu.force]
    table = np.column_stack([imu.time * scale, *columns])
    path.write_text("\n".join([head, *(",".join(f"{v:.9g}" for v in row) for row in table)]))
    return path


@pytest.mark.parametrize(("head", "scale"), HEADS.items())
def test_files_are_read_by_their_header(rng, tmp_path, head, scale):
    imu = sensor(rng)
    read = read_imu(written(tmp_path / "imu.csv", head, scale, imu))
    assert read.time == pytest.approx(imu.time, abs=1e-6)
    assert read.rate == pytest.approx(imu.rate, rel=1e-6)
    assert read.force == pytest.approx(imu.force, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda i: Imu(i.time, i.rate, i.force / 9.81), "as if in g.*9.81 m/s"),
        (lambda i: Imu(i.time, np.degrees(i.rate), i.force), "not degrees"),
        (lambda i: Imu(i.time[::-1], i.rate, i.force), "measurement 1: its time"),
        (lambda i: Imu(i.time[:50], i.rate[:50], i.force[:50]), "holds 50 measurements"),
        (lambda i: Imu(i.time, i.rate, i.force * np.nan), "line 2.*finite"),
    ],
)
def test_other_units_and_times_are_refused(rng, tmp_path, change, says):
    path = written(tmp_path / "imu.csv", next(iter(HEADS)), 1.0, change(sensor(rng)))
    with pytest.raises(FileError, match=says):
        read_imu(path)


def test_other_columns_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("t,x,y\n1,2,3\n")
    with pytest.raises(FileError, match=r"columns t, x, y.*timestamp_s,gx"):
        read_imu(tmp_path / "a.csv")
