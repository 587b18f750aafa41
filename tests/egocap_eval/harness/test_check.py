"""The guard catches what it is there to catch: things are broken on purpose."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from egocap.body.labels import MIRROR
from egocap.errors import FileError
from egocap.pose.config import TrackerConfig
from egocap_eval.cli import main
from egocap_eval.harness import check, check_suite
from egocap_eval.harness.check import Comparison, compare_numbers, load_baseline
from egocap_eval.harness.check_suite import Number, Pipeline, measure_suite
from egocap_eval.harness.motion_truth import simulate_motion

CONDITIONS = (
    "exact",
    "exact-live",
    "blind",
    "blind-posture",
    "blind-plain",
    "learned-plain",
    "live",
)
SEEDS = 3


@pytest.fixture(scope="module")
def motions():
    return [simulate_motion(motion, frames=60, seed=seed, rig=rig)
            for motion, rig, seed in check_suite.MOTIONS[::2]]  # fmt: skip


@pytest.fixture(scope="module")
def baseline(motions):
    return measure_suite(motions=motions, conditions=CONDITIONS, seeds=SEEDS)


def verdicts(baseline, motions, pipeline, conditions):
    """How many numbers got worse."""
    now = measure_suite(pipeline, motions=motions, conditions=conditions, seeds=SEEDS)
    names = [name for name in baseline if name.split("/")[0] in conditions]
    compared = compare_numbers({name: baseline[name] for name in names},
                               {name: now[name].value for name in names})  # fmt: skip
    return [c.verdict for c in compared]


def weight(name):
    return Pipeline(config=lambda config: replace(config, **{name: 0.0}))


def mirrored(found):
    """Left and right wrist exchanged."""
    order = np.arange(18)
    wrists = [4, MIRROR[4]]
    order[wrists] = wrists[::-1]
    return replace(found, points=found.points[:, :, order], valid=found.valid[:, :, order])


def tilted(rig):
    """The left camera nodding 2 degrees more than the tracker believes."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("x", 2.0, degrees=True).as_matrix()
    left, *others = rig.mounts
    return replace(rig, mounts=(replace(left, T_head_camera=left.T_head_camera @ T), *others))


def halved(joints):
    return joints.astype(np.float16).astype(np.float64)


def test_the_same_code_gives_the_same_numbers(baseline, motions):
    assert set(verdicts(baseline, motions, Pipeline(), ("exact", "blind", "live"))) == {"same"}


FAULTS = {
    "a mirrored joint pair": (Pipeline(detections=mirrored), ("exact",)),
    "a camera tilted by 2 degrees": (Pipeline(rig=tilted), ("exact",)),
    "half-precision poses": (Pipeline(joints=halved), ("exact",)),
    "no memory of the velocity": (weight("zeta"), ("exact-live",)),
}
SHOWS_IN = {
    "lambda_detection": ("exact",), "lambda_motion": ("blind",), "lambda_pose": ("blind-plain",),
    "lambda_posture": ("blind-posture",), "lambda_smooth": ("live",),
    "lambda_limit": ("learned-plain",),
}  # fmt: skip
FAULTS |= {
    f"{name} = 0": (weight(name), SHOWS_IN.get(name, CONDITIONS))
    for name, value in vars(TrackerConfig()).items()
    if name.startswith("lambda_") and value > 0
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_caught(baseline, motions, fault):
    pipeline, conditions = FAULTS[fault]
    try:
        found = verdicts(baseline, motions, pipeline, conditions)
    except np.linalg.LinAlgError:
        return  # limbs without any prior have no covariance: caught louder still
    assert "worse" in found


def test_verdicts():
    known = {
        "a": Number(10.0, 0.5, "lower", "mm"), "b": Number(10.0, 0.5, "lower", "mm"),
        "c": Number(90.0, 1.0, "higher", "%"), "d": Number(3.0, 0.1, "equal", "px"),
        "e": Number(1.0, 0.1, "lower", "mm"), "f": Number(5.0, 0.5, "lower", "mm"),
    }  # fmt: skip
    now = {"a": 10.4, "b": 10.6, "c": 88.0, "d": 2.8, "f": 4.0, "g": 7.0}
    found = {c.name: c.verdict for c in compare_numbers(known, now)}
    assert found == {"a": "same", "b": "worse", "c": "worse", "d": "worse", "e": "gone",
                     "f": "better", "g": "new"}  # fmt: skip
    assert Comparison("c", known["c"], 92.0).verdict == "better"


def test_the_command_exits_with_3_and_a_table(tmp_path, monkeypatch, capsys):
    values = {"value": 7.0, "tolerance": 0.3, "better": "lower", "unit": "mm"}
    numbers = {"noisy/walk/mpjpe_mm": Number(**values)}
    monkeypatch.setattr(check, "measure_suite", lambda **options: numbers)
    path = tmp_path / "ci.json"
    words = ["check", "--baseline", str(path), "--no-rendered"]
    assert main([*words, "--record"]) == 0
    assert load_baseline(path) == numbers
    assert main(words) == 0
    numbers["noisy/walk/mpjpe_mm"] = Number(**(values | {"value": 7.5}))
    capsys.readouterr()
    assert main(words) == 3
    captured = capsys.readouterr()
    assert "Worse than the baseline" in captured.out and "7.5" in captured.out
    assert captured.err == "missed: noisy/walk/mpjpe_mm: worse\n"


def test_the_committed_baseline_knows_every_condition():
    names = {name.split("/")[0] for name in load_baseline(check.COMMITTED)}
    assert {*check_suite.CONDITIONS, "physics", "rig", "rendered"} <= names


def test_a_baseline_that_is_none(tmp_path, capsys):
    (tmp_path / "ci.json").write_text('{"schema": 1, "command": "x", "result": {"numbers": [1]}}')
    with pytest.raises(FileError, match="not a baseline"):
        load_baseline(tmp_path / "ci.json")
    assert main(["check", "--baseline", str(tmp_path / "none.json")]) == 2
    assert "no such file" in capsys.readouterr().err
