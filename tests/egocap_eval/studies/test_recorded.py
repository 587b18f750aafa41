"""The study of recorded motions: whose clips, which frames, and how they are averaged."""

from pathlib import Path

import numpy as np
import pytest

from egocap.errors import InputError
from egocap.evaluation.pose_errors import GroundTruth
from egocap.evaluation.scoring import evaluate_pose
from egocap_eval.sets.motion_sets import motion_sets
from egocap_eval.studies.recorded import (
    CASES,
    DARK,
    LAGGED,
    POSE,
    clip_seeds,
    means,
    measures_of,
    missed,
    pose_scores,
    scenes_of,
    study,
    tables,
)

MOTIONS = Path(__file__).parents[4] / "shared" / "motions"


def clips_in(folder, *names):
    for name in names:
        (folder / name).write_text("")
    return folder


def test_a_clip_keeps_its_person_whichever_clips_are_chosen(tmp_path):
    folder = clips_in(tmp_path, "007_01.bvh", "007_02.bvh", "walking_4.npz", "002_01.bvh")
    every = clip_seeds(folder, "validation", ())
    assert [p.stem for p in every] == ["007_01", "007_02", "walking_4"]
    assert clip_seeds(folder, "validation", ("walking_4",)) == {
        folder / "walking_4.npz": every[folder / "walking_4.npz"]
    }
    first, last = motion_sets().seeds["validation"]
    assert all(first <= seed <= last for seed in every.values())
    with pytest.raises(InputError, match=r"no clip 002_01.*007_01"):
        clip_seeds(folder, "validation", ("002_01",))
    with pytest.raises(InputError, match="test set"):
        clip_seeds(folder, "test", ())


def test_the_test_set_needs_a_reason(tmp_path):
    folder = clips_in(tmp_path, "cmu_13_01.bvh")
    with pytest.raises(InputError, match="--reason"):
        study(folder, set="test", work=tmp_path / "work")
    assert not (tmp_path / "work").exists()
    with pytest.raises(InputError, match="learned"):
        study(folder, detections="simulated:2.0")


@pytest.mark.skipif(not MOTIONS.is_dir(), reason="no motion clips")
def test_the_middle_of_the_clip_is_taken():
    scene, fit = scenes_of(MOTIONS / "bvh" / "007_05.bvh", 700_001, 90)
    assert scene.frames == 90 and scene.seed == fit.seed == 700_001
    assert scene.motion.start_s == pytest.approx(0.5 * (259 / 60 - 91 / 30), abs=0.1)
    assert (fit.frames, fit.fps) == (120, 10) and fit.motion.name == "sequence"
    whole, _ = scenes_of(MOTIONS / "bvh" / "007_05.bvh", 700_001, 10_000)
    assert 120 <= whole.frames <= 130 and whole.motion.start_s == 0.0


def test_scores_of_a_report_are_by_part_of_the_body():
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(4, 18, 3))
    moved = joints.copy()
    moved[:, 13, 0] += 0.1  # left foot
    scores = pose_scores(evaluate_pose(moved, GroundTruth(joints, np.arange(4) / 30)))
    assert tuple(scores) == POSE
    assert scores["feet_mm"] == pytest.approx(50.0) and scores["ankles_mm"] == 0.0
    assert scores["arms_mm"] == 0.0 and scores["legs_mm"] > 10.0
    assert scores["hidden_mm"] is None


def test_means_are_over_clips_with_their_interval():
    found = means([{"a": 10.0, "b": None}, {"a": 20.0, "b": 1.0}, {"a": 30.0, "b": None}])
    assert found["a"]["mean"] == 20.0 and 10.0 <= found["a"]["low"] < 20.0 < found["a"]["high"]
    assert found["b"] is None
    row = {"clip": "x", "frames": 5, "detector": dict.fromkeys(
        [f"{m}_{k}" for k in ("visible", "in_view")
         for m in ("pck20", "auc20", "normalised_error", "wrist", "knee", "ankle", "foot")],
        90.0)}  # fmt: skip
    row |= {case: dict.fromkeys(measures_of(case), 20.0) for case in CASES if case != "detector"}
    result = {"set": "validation", "rows": [row], "left_out": {"y": "why"},
              "mean": {case: means([row[case]]) for case in CASES}}  # fmt: skip
    made = tables(result)
    assert len(made) == len(CASES) + 1 and made[-1].rows == (("y", "why"),)
    assert made[0].rows[0][2] == "90.0"


def test_targets_of_the_online_tracker_are_named_where_they_are_missed():
    def result(lagged, spent):
        errors = {"offline": 20.0, "live": 31.0, LAGGED: lagged}
        rows = [{"clip": "x", DARK: {"recovery_s": spent}}]
        return {"rows": rows, "mean": {c: {"mpjpe_mm": {"mean": e}} for c, e in errors.items()}}

    assert missed(result(25.0, 0.3)) == missed(result(25.0, None)) == []
    found = missed(result(27.0, 0.4))
    assert "1.35 times" in found[0] and "x: recovered 0.40 s" in found[1]
