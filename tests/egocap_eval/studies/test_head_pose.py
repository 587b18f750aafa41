"""Scores of head poses with known errors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.errors import InputError
from egocap.geometry import rigid
from egocap.head_pose.result import HeadTrajectory
from egocap_eval.studies import head_pose
from egocap_eval.studies.head_pose import MOST_MM, behind, misses, score


def truth(count=90):
    t = np.arange(count) / 30.0
    R = Rotation.from_euler("ZY", np.stack([0.5 * t, 0.1 * np.sin(3 * t)], -1)).as_matrix()
    return rigid(R, np.stack([t, np.sin(t), 1.6 + 0 * t], -1))


def found(poses):
    covariance = np.tile(1e-4 * np.eye(6), (len(poses), 1, 1))
    return HeadTrajectory(
        np.arange(len(poses)), np.arange(len(poses)) / 30.0, poses, (), covariance
    )


def test_another_heading_and_origin_is_no_error():
    T = rigid(Rotation.from_euler("Z", 1.0).as_matrix(), np.array([3.0, -2.0, 0.0]))
    scores = score(found(T @ truth()), truth())
    for key in ("first_aligned_mm", "all_aligned_mm", "rotation_deg", "drift_percent",
                "scale_error_percent", "up_error_deg", "height_error_mm"):  # fmt: skip
        assert scores[key] == pytest.approx(0.0, abs=1e-4), key


def test_scale_is_an_error_and_is_told():
    scaled = truth()
    scaled[:, :3, 3] *= 0.98
    scores = score(found(scaled), truth())
    assert scores["scale_error_percent"] == pytest.approx(100 * (1 / 0.98 - 1), rel=1e-6)
    assert scores["first_aligned_mm"] > scores["all_aligned_mm"] > 1.0


def test_tilt_and_height_are_those_of_the_world():
    T = rigid(Rotation.from_euler("X", 2.0, degrees=True).as_matrix(), np.array([0.0, 0.0, 0.05]))
    scores = score(found(T @ truth()), truth())
    assert scores["up_error_deg"] == pytest.approx(2.0, abs=1e-6)
    up = score(found(rigid(np.eye(3), np.array([0.0, 0.0, 0.05])) @ truth()), truth())
    assert up["height_error_mm"] == pytest.approx(50.0)


def test_an_end_off_by_one_standard_deviation_is_one():
    poses = truth()
    poses[-1, 0, 3] += np.sqrt(3e-4)
    scores = score(found(poses), truth())
    assert scores["end_error_in_std"] == pytest.approx(1.0)
    assert scores["drift_percent"] == pytest.approx(100 * np.sqrt(3e-4) / scores["path_m"])


def test_missed_targets_are_named():
    row = {"first_aligned_mm": 2 * MOST_MM, "rotation_deg": 0.0, "drift_percent": 0.0,
           "cpu_ms_per_frame": 1.0, "frames": 5, "posed": 4}  # fmt: skip
    assert misses(row) == ["20 mm (target 10)", "1 frames without a pose"]


def test_an_odometry_twice_as_far_off_is_named():
    sfm = {"all_aligned_mm": 1.0, "rotation_all_aligned_deg": 0.02}
    assert behind({"all_aligned_mm": 1.9, "rotation_all_aligned_deg": 0.04}, sfm) == []
    (said,) = behind({"all_aligned_mm": 2.1, "rotation_all_aligned_deg": 0.04}, sfm)
    assert said.startswith("2.1 mm by odometry")


def test_poses_without_covariance_have_no_error_in_standard_deviations():
    bare = HeadTrajectory(np.arange(90), np.arange(90) / 30.0, truth())
    assert score(bare, truth())["end_error_in_std"] is None


def test_cases_are_measured_alone_and_unknown_ones_refused(monkeypatch, tmp_path):
    row = {"first_aligned_mm": 1.0, "rotation_deg": 0.0, "drift_percent": 0.0,
           "cpu_ms_per_frame": 1.0, "frames": 5, "posed": 5}  # fmt: skip
    measured = []
    monkeypatch.setattr(head_pose, "prepare_sequence", lambda *told: None)
    monkeypatch.setattr(head_pose, "Covered", lambda folder, covered: None)
    monkeypatch.setattr(head_pose, "content_hashes", lambda sequences: {})
    monkeypatch.setattr(head_pose, "_table", lambda rows: None)
    monkeypatch.setattr(
        head_pose, "measure", lambda sequence, name, *more: measured.append(name) or row
    )
    monkeypatch.setattr(
        head_pose, "measure_live", lambda sequence, name: measured.append(f"{name}, live")
    )
    assert head_pose.study(tmp_path, cases=("minute",)).missed == []
    assert measured == ["minute", "minute, live"]
    with pytest.raises(InputError, match="unknown case 'hour'"):
        head_pose.study(tmp_path, sfm=("hour",))


def test_live_poses_are_scored_from_where_they_begin(monkeypatch, tiny_sequence):
    class Late:
        def __init__(self, rig, *, waits):
            self.given = 0

        def step(self, images, when):
            self.given += 1
            return None if self.given < 3 else truth[self.given - 1]

        def facts(self):
            return {"posed": self.given - 2}

        def close(self):
            pass

    sequence = head_pose.Covered(tiny_sequence, range(0))
    truth = sequence.truth.T_world_head
    monkeypatch.setattr(head_pose, "OnlineHeadPose", Late)
    row = head_pose.measure_live(sequence, "tiny")
    assert row["posed"] == len(sequence) - 2 and row["worst_mm"] < 1e-6
    monkeypatch.setattr(Late, "step", lambda self, images, when: None)
    assert "worst_mm" not in head_pose.measure_live(sequence, "tiny")


def test_covered_frames_have_no_picture(tiny_sequence):
    covered = head_pose.Covered(tiny_sequence, range(2, 4))
    shown = [covered.image_suffix(i, 0) is not None for i in range(5)]
    assert shown == [True, True, False, False, True]
    assert [covered.picture(i, 1) is not None for i in range(5)] == shown
