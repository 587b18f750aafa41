"""egocap head-pose: files of other programs at a sequence's frames, and what it refuses."""

import json

import numpy as np
import pytest

from egocap.data.head_pose import load_head_pose
from egocap.data.sequence import Sequence
from egocap.geometry import inverse
from egocap.head_pose.config import SfmConfig
from egocap.head_pose.map_poses import MapPoses
from egocap.odometry.views import Views
from tests.egocap.cli.test_cli import complaint
from tests.egocap.head_pose.motion import T_DEVICE_HEAD, head_motion, quaternions


def tum(path, time, poses):
    rows = np.concatenate([time[:, None], poses[:, :3, 3], quaternions(poses[:, :3, :3])], 1)
    np.savetxt(path, rows, fmt="%.9f")
    return path


def test_a_trajectory_is_read_at_the_frames_that_it_covers(egocap, tiny_sequence, tmp_path):
    times = Sequence(tiny_sequence).times
    known = np.arange(-3, 4) / 30.0
    file = tum(tmp_path / "t.txt", known + 100.0, head_motion(known))
    out = tmp_path / "head.npz"
    words = ["--trajectory", file, "--out", out, "--time-offset", "-100", "--json"]
    code, printed, _ = egocap("head-pose", tiny_sequence, *words)
    assert code == 0
    told = json.loads(printed)
    assert (told["posed"], told["frames"]) == (4, len(times))
    assert told["gaps"] == [{"first": 4, "last": 6, "reason": "not in the trajectory"}]
    time, poses = load_head_pose(out)
    assert time == pytest.approx(times[:4])
    assert poses == pytest.approx(head_motion(times[:4]), abs=1e-6)


def test_a_reference_gives_clock_and_mount(egocap, tiny_sequence, tmp_path):
    reference = np.arange(300) / 30.0
    np.savez(tmp_path / "ref.npz", time=reference, T_world_head=head_motion(reference))
    own = np.arange(0.0, 9.5, 0.02)
    file = tum(tmp_path / "t.txt", own + 7.5, head_motion(own) @ inverse(T_DEVICE_HEAD))
    out = tmp_path / "head.npz"
    words = ["--trajectory", file, "--reference", tmp_path / "ref.npz", "--out", out, "--json"]
    code, printed, _ = egocap("head-pose", tiny_sequence, *words)
    assert code == 0
    told = json.loads(printed)
    assert told["offset_s"] == pytest.approx(-7.5, abs=2e-3)
    time, poses = load_head_pose(out)
    assert poses[:, :3, 3] == pytest.approx(head_motion(time)[:, :3, 3], abs=5e-3)


@pytest.mark.parametrize(
    ("words", "says"),
    [(["--reference", "r.npz"], "without --trajectory"),
     (["--trajectory", "t.txt", "--fewest", "30"], "one of pictures and trajectory"),
     (["--trajectory", "t.txt"], "some of the frames' times"),
     (["--trajectory", "none.txt"], "no such file"),
     (["--trajectory", "t.txt", "--imu", "i.csv"], "one of pictures and trajectory"),
     (["--imu", "t.txt"], "timestamp_s,gx,gy,gz,ax,ay,az"),
     (["--trajectory", "t.txt", "--format", "euroc"], "line 1"),
     (["--trajectory", "t.txt", "--reference", "none.npz"], "no such file"),
     (["--trajectory", "t.txt", "--method", "sfm"], "one of pictures and trajectory"),
     (["--method", "sfm", "--fewest", "30"], "settings of another method with --method sfm"),
     (["--sfm.every", "2"], "settings of another method with --method odometry"),
     (["--method", "sfm", "--sfm.every", "0"], "below 1")],
)  # fmt: skip
def test_what_cannot_be_used_is_one_line(egocap, tiny_sequence, tmp_path, words, says):
    tum(tmp_path / "t.txt", 50.0 + np.arange(9) / 30.0, head_motion(np.arange(9)))
    out = tmp_path / "h.npz"
    assert says in complaint(egocap("head-pose", tiny_sequence, "--out", out, *words))
    assert not out.exists()


def test_structure_from_motion_has_the_sequence_the_body_and_its_settings(
    egocap, tiny_sequence, tmp_path, monkeypatch
):  # fmt: skip
    asked = []

    def solve(sequence, config, rig, track, advance):
        asked.append((len(sequence), config, rig.name, track))
        frames = np.array([1, 2, 3])
        poses = head_motion(sequence.times[frames])
        return MapPoses(frames, sequence.times[frames], poses, None, np.zeros((0, 3)),
                        Views.of(rig, config.width),
                        {"method": "sfm", "points": 0}, {0: "dark"}, {})  # fmt: skip

    name = "egocap.head_pose.from_pictures.by_structure_from_motion"
    monkeypatch.setattr(name, solve)
    words = ["--method", "sfm", "--sfm.every", "2", "--out", tmp_path / "h.npz", "--json"]
    code, printed, err = egocap("head-pose", tiny_sequence, *words)
    assert code == 0, err
    assert asked == [(7, SfmConfig(every=2), Sequence(tiny_sequence).rig.name, None)]
    told = json.loads(printed)
    assert (told["method"], told["posed"], told["gaps"][0]["reason"]) == ("sfm", 3, "dark")
    assert len(load_head_pose(tmp_path / "h.npz")[0]) == 3
