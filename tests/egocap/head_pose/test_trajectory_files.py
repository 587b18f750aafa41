"""Trajectories of every format, written from known poses as their documentation says."""

import numpy as np
import pytest

from egocap.errors import FileError
from egocap.geometry import inverse
from egocap.head_pose.trajectory_files import R_DEVICE_HEAD_XR, read_trajectory
from tests.egocap.head_pose.motion import head_motion, quaternions

TIME = 100.0 + np.arange(20) / 25.0
POSES = head_motion(TIME - 100.0)


ROWS = np.concatenate([POSES[:, :3, 3], quaternions(POSES[:, :3, :3])], 1)


def tum():
    lines = [f"{t:.6f} " + " ".join(f"{v:.9f}" for v in row)
             for t, row in zip(TIME, ROWS, strict=True)]  # fmt: skip
    return "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines)


def euroc():
    lines = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], "
             "q_RS_y [], q_RS_z [], v_RS_R_x [m s^-1]"]  # fmt: skip
    for t, row in zip(TIME, ROWS, strict=True):
        values = [*row[:3], row[6], *row[3:6], 0.0]
        lines.append(f"{round(t * 1e9)}," + ",".join(f"{v:.9f}" for v in values))
    return "\n".join(lines)


def aria():
    lines = ["graph_uid,tracking_timestamp_us,utc_timestamp_ns,tx_world_device,ty_world_device,"
             "tz_world_device,qx_world_device,qy_world_device,qz_world_device,qw_world_device,"
             "gravity_x_world,gravity_y_world,gravity_z_world,quality_score"]  # fmt: skip
    for t, row in zip(TIME, ROWS, strict=True):
        values = ",".join(f"{v:.9f}" for v in row)
        lines.append(f"a-b-c,{round(t * 1e6)},-1,{values},0,0,-9.81,1.0")
    return "\n".join(lines)


def arkit():
    lines = ["timestamp,x,y,z,qx,qy,qz,qw"]
    for t, row in zip(TIME, ROWS, strict=True):
        lines.append(f"{t:.6f}," + ",".join(f"{v:.9f}" for v in row))
    return "\n".join(lines)


def openxr():
    lines = ["# OpenXR", "time_ns,position_x,position_y,position_z,orientation_x,orientation_y,"
             "orientation_z,orientation_w"]  # fmt: skip
    for t, row in zip(TIME, ROWS, strict=True):
        lines.append(f"{round(t * 1e9)}," + ",".join(f"{v:.9f}" for v in row))
    return "\n".join(lines)


def colmap():
    lines = ["# Image list with two lines of data per image:",
             "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
             "#   POINTS2D[] as (X, Y, POINT3D_ID)"]  # fmt: skip
    for i, T in enumerate(inverse(POSES)):
        q = quaternions(T[None, :3, :3])[0]
        values = " ".join(f"{v:.9f}" for v in [q[3], *q[:3], *T[:3, 3]])
        lines += [f"{i + 1} {values} 1 left/{i:06d}.png", "" if i % 2 else "10 20 -1 30 40 5"]
    return "\n".join(lines)


WRITERS = {f.__name__: f for f in (tum, euroc, aria, arkit, openxr, colmap)}


@pytest.mark.parametrize("form", WRITERS)
def test_every_format_is_recognised_and_read(tmp_path, form):
    path = tmp_path / "trajectory.txt"
    path.write_text(WRITERS[form]())
    found = read_trajectory(path)
    assert found.form == form
    expected = np.arange(20) if form == "colmap" else TIME
    assert found.time == pytest.approx(expected, abs=1e-5)
    assert found.T_world_device == pytest.approx(POSES, abs=1e-6)


def test_the_axes_of_a_headset_are_those_of_the_head():
    forward_left_up = R_DEVICE_HEAD_XR @ np.eye(3)
    assert forward_left_up[:, 0].tolist() == [0, 0, -1]  # forward is the device's -z
    assert forward_left_up[:, 1].tolist() == [-1, 0, 0]
    assert forward_left_up[:, 2].tolist() == [0, 1, 0]
    assert np.linalg.det(R_DEVICE_HEAD_XR) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [(lambda t: t.replace("100.040000", "nan", 1), "line 3: not a finite"),
     (lambda t: "\n".join(t.splitlines()[:2]), "two or more"),
     (lambda t: t + "\n" + t.splitlines()[1], "twice"),
     (lambda t: t + "\n102 1 2", r"line 22: 3 numbers.*8"),
     (lambda t: t + "\n102 1 2 3 0 0 0 x", "line 22: not a number"),
     (lambda t: t + "\n102 1 2 3 0 0 0 inf", "line 22: not a finite"),
     (lambda t: t + "\n102 1 2 3 0 0 0 0.5", "quaternion of length 0.5")],
)  # fmt: skip
def test_bad_lines_are_named(tmp_path, change, says):
    path = tmp_path / "t.txt"
    path.write_text(change(tum()))
    with pytest.raises(FileError, match=says):
        read_trajectory(path, "tum")


def test_missing_columns_are_named(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(aria().replace("qw_world_device", "q_w"))
    with pytest.raises(FileError, match="line 1: no column qw_world_device"):
        read_trajectory(path)


def test_gravity_of_no_direction_is_refused(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text(aria().replace("0,0,-9.81", "0,0,0"))
    with pytest.raises(FileError, match=r"gravity_x_world .*valid: a direction"):
        read_trajectory(path)


def test_pictures_of_colmap_without_lines_of_points_are_refused(tmp_path):
    """Every second one would be taken for points."""
    path = tmp_path / "images.txt"
    path.write_text("\n".join(line for line in colmap().splitlines() if ".png" in line))
    with pytest.raises(FileError, match=r"line 2: .*two lines a picture"):
        read_trajectory(path, "colmap")


@pytest.mark.parametrize("text", ["", "hello\n", "a,b,c\n1,2,3\n", "1 2 3\n"])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(FileError, match="not a known trajectory"):
        read_trajectory(path)
