"""Scores of captured footage whose clocks and errors are known; a command's time and memory."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import InputError, MachineError
from egocap.geometry import rigid
from egocap.media.video import open_video
from egocap_eval.footage.captures import joint_error_mm, path_scores, scene_times, study
from egocap_eval.footage.memory import write_loop
from egocap_eval.footage.process import run_egocap
from egocap_eval.footage.synchronisation import clock_scores


class Recorded(SimpleNamespace):
    """What the scores use of a sequence."""

    def __len__(self):
        return len(self.times)


def sequence(frames=50, fps=10.0, late=0.004):
    times = np.arange(frames) / fps
    joints = np.zeros((frames, 18, 3))
    joints[:, :, 0] = times[:, None]  # 1 m/s
    sensor = SimpleNamespace(time=np.stack([times + late, times], 1),
                             exposure_ev=np.array([[1.0, 0.0]]))  # fmt: skip
    return Recorded(times=times, sensor=sensor, truth=SimpleNamespace(joints_head=joints),
                           manifest=SimpleNamespace(fps=fps))  # fmt: skip


def test_errors_are_taken_at_the_scenes_time_of_the_files_pictures():
    one = sequence()
    planted = {"left": {"frames": [3, 4, 6]}, "right": {"frames": [0]}}
    times = scene_times(one, planted, np.array([0.0, 0.1, 0.25]))
    np.testing.assert_allclose(times, [0.304, 0.404, 0.554])
    joints = np.zeros((3, 18, 3))
    joints[:, :, 0] = times[:, None] + 0.01
    assert joint_error_mm(joints, one, times) == pytest.approx(10.0)


def test_errors_of_a_path_are_taken_at_the_same_times(tmp_path):
    """A path in a world that is turned, shifted and 5 mm too high, without its first frames."""
    one = sequence()
    turn = Rotation.from_euler("z", one.times[:, None], degrees=True).as_matrix()
    one.truth.T_world_head = rigid(turn, np.stack([one.times, 0 * one.times, 1 + 0 * one.times], 1))
    own = np.arange(40) / 10.0
    times = own + 0.25
    true = rigid(Rotation.from_euler("z", times[:, None], degrees=True).as_matrix(),
                 np.stack([times, 0 * times, 1 + 0 * times], 1))  # fmt: skip
    other = rigid(Rotation.from_euler("z", 70.0, degrees=True).as_matrix(), np.array([3, 1, 0.005]))
    stated = {"up_std_deg": 0.2, "floor_std_mm": 8.0}
    np.savez(tmp_path / "h.npz", time=own[10:], T_world_head=(other @ true)[10:],
             facts=json.dumps({"vertical": stated}))  # fmt: skip
    found = path_scores(tmp_path / "h.npz", one, times, own)
    known = {"all_aligned_mm": 0.0, "up_error_deg": 0.0, "height_error_mm": 5.0, "placed": 0.75}
    assert found == pytest.approx(known | stated, abs=1e-4)
    without = path_scores(tmp_path / "none.npz", one, times, own)
    assert without.keys() == found.keys() and without["up_error_deg"] is None


def test_clocks_and_losses_are_compared_with_what_was_planted():
    view = {"offset_s": 0.0, "drift_ppm": 0.0, "gain": [1.0, 1.0, 1.0], "places": [*range(20)],
            "lost": [4, 5], "repeated": [7]}  # fmt: skip
    planted = {"left": view, "right": view | {"offset_s": 0.2, "drift_ppm": 40.0}}
    timing = SimpleNamespace(offset_s=0.2 + 1e-6, drift_ppm=39.0, offset_std_s=0.001,
                             drift_std_ppm=5.0, note="from sound")  # fmt: skip
    gain = SimpleNamespace(gain=(2**0.5, 2**0.5, 2**0.5 * 1.1))
    footage = SimpleNamespace(
        views=[None, SimpleNamespace(timing=timing, colour=gain)],
        report={"left": {"dropped": 2, "repeated": 1}, "right": {"dropped": 1, "repeated": 3}},
    )
    found = clock_scores(sequence(), planted, footage)
    assert found["lag_error_ms"] == pytest.approx(0.0, abs=1e-9)  # 1 us at the start, -1 ppm x 1 s
    assert found["drift_error_ppm"] == pytest.approx(-1.0)
    assert (found["unreported"], found["invented"]) == (1, 2)
    assert found["colour_error_percent"] == pytest.approx(10.0)


def test_a_command_and_what_it_takes():
    spent = run_egocap(["import", "--help"])
    assert 0.05 < spent.cpu_s < 30.0 and spent.wall_s > 0.2 and spent.peak_mb > 5.0
    with pytest.raises(MachineError, match=r"'egocap import --out nowhere \.\.\.' exited with 2"):
        run_egocap(["import", "--out", "nowhere"])


def test_a_loop_goes_back_the_way_it_came(tmp_path):
    pictures = [np.full((32, 48, 3), 60 * k + 20, np.uint8) for k in range(4)]
    write_loop(tmp_path / "a.mp4", pictures, 9)
    video = open_video(tmp_path / "a.mp4")
    grey = [image.mean() for _, image in video.frames()]
    np.testing.assert_allclose(grey, [20, 80, 140, 200, 140, 80, 20, 80, 140], atol=3)
    np.testing.assert_allclose(np.diff(video.times), 1 / 30, atol=1e-4)


def test_captures_need_motions():
    with pytest.raises(InputError, match="no --motions"):
        study()
