"""The neutral file: both forms round trip, and whatever is wrong is named."""

import json

import numpy as np
import pytest

from egocap.body.joint_names import DATASET_NAMES
from egocap.body.labels import LABEL_INDEX, LABELS
from egocap.errors import FileError
from egocap.evaluation.predictions import Predictions, load_predictions, save_predictions


def predictions(frames=5):
    rng = np.random.default_rng(0)
    valid = rng.random((frames, 18)) > 0.2
    positions = np.where(valid[..., None], rng.normal(size=(frames, 18, 3)), 0.0)
    return Predictions(
        positions, valid, "camera:left", "m", np.arange(frames) + 2, None, "mine", 0.1
    )


def arrays(**changes):
    """A good archive of UnrealEgo's joints in centimetres, with changes; None drops an array."""
    names = list(DATASET_NAMES["unrealego"])
    rng = np.random.default_rng(1)
    good = {
        "format": "egocap-predictions", "version": 1, "joints": [*names, "pelvis"],
        "names": "unrealego", "unit": "cm", "frame": "head",
        "positions": rng.normal(size=(4, 17, 3)).astype(np.float32), "times": np.arange(4) / 30,
    } | changes  # fmt: skip
    return {k: v for k, v in good.items() if v is not None}


def header(**changes):
    good = {"format": "egocap-predictions", "version": 1, "joints": ["neck", "left_hand"],
            "unit": "m", "frame": "head"} | changes  # fmt: skip
    return {k: v for k, v in good.items() if v is not None}


def lines(*records, **changes):
    return "\n".join(json.dumps(r) for r in (header(**changes), *records)) + "\n"


@pytest.mark.parametrize("suffix", [".npz", ".jsonl"])
def test_round_trip(tmp_path, suffix):
    path, before = tmp_path / f"poses{suffix}", predictions()
    save_predictions(path, before)
    after = load_predictions(path)
    np.testing.assert_array_equal(after.valid, before.valid)
    np.testing.assert_allclose(after.positions[after.valid], before.positions[before.valid])
    np.testing.assert_array_equal(after.frames, before.frames)
    assert (after.frame, after.method, after.seconds_per_frame) == ("camera:left", "mine", 0.1)
    assert after.times is None and [p.name for p in tmp_path.iterdir()] == [path.name]


def test_other_names_and_units(tmp_path):
    content = arrays()
    np.savez(tmp_path / "poses.npz", **content)
    found = load_predictions(tmp_path / "poses.npz")
    row = content["joints"].index("hand_l")
    np.testing.assert_allclose(
        found.positions[:, LABEL_INDEX["left_wrist"]], content["positions"][:, row] / 100
    )
    missing = [LABELS[j] for j in range(18) if not found.valid[:, j].any()]
    assert missing == ["left_hand", "right_hand"] and found.frames is None


def test_joints_that_are_not_scored_are_said(tmp_path, caplog):
    content = arrays()
    np.savez(tmp_path / "poses.npz", **content)
    load_predictions(tmp_path / "poses.npz")
    assert not caplog.records  # a joint of theirs that is no label is no mistake
    content["joints"] = ["Tail" if n == "hand_l" else n for n in content["joints"]]
    np.savez(tmp_path / "poses.npz", **content)
    load_predictions(tmp_path / "poses.npz")
    (said,) = caplog.records
    assert "without left_wrist; unknown: Tail, pelvis" in said.message


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "poses"}, "key 'format'.*egocap-predictions"),
        ({"version": 2}, "key 'version'"),
        ({"unit": None}, "key 'unit': field required"),
        ({"unit": "feet"}, "key 'unit'.*'m', 'cm' or 'mm'"),
        ({"frame": "pelvis"}, "key 'frame'.*head, world or camera:VIEW"),
        ({"names": "coco"}, "key 'names'.*unrealego"),
        ({"names": None}, "key 'joints'.*names of unrealego"),
        ({"positions": None}, "key 'positions'"),
        ({"positions": np.zeros((4, 17, 3), np.float16)}, "float16.*half precision"),
        ({"positions": np.zeros((4, 17, 3), int)}, "int64"),
        ({"positions": np.zeros((4, 3, 17))}, r"\(4, 3, 17\)"),
        ({"positions": np.zeros((0, 17, 3)), "times": np.zeros(0)}, r"\(0, 17, 3\)"),
        ({"positions": np.full((4, 17, 3), np.nan)}, "head in row 0.*68 places"),
        ({"positions": np.full((4, 17, 3), 1e300)}, "too large, for head in row 0.*68 places"),
        ({"seconds_per_frame": 1e-320}, "key 'seconds_per_frame'"),
        ({"valid": np.ones((4, 16), bool)}, "key 'valid'"),
        ({"times": None}, "neither frame numbers nor times"),
        ({"times": np.zeros(3)}, "key 'times'"),
        ({"frames": np.arange(4) * 0.5}, "key 'frames'.*whole numbers"),
        ({"joints": ["head", *["x"] * 15, "head"]}, "occurs twice"),
        ({"seconds_per_frame": -1.0}, "key 'seconds_per_frame'"),
        ({"poses": np.zeros(3)}, "unknown key"),
    ],
)  # fmt: skip
def test_a_bad_archive_names_the_array(tmp_path, changes, message):
    np.savez(tmp_path / "poses.npz", **arrays(**changes))
    with pytest.raises(FileError, match=message):
        load_predictions(tmp_path / "poses.npz")


GOOD = {"frame": 0, "positions": [[0, 0, 0], None]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (lines(GOOD, {"frame": 1, "positions": [[0, 0, 0]]}), "line 3.*1 instead of 2"),
        (lines({"frame": 0, "positions": [[0, 0], None]}), "line 2.*positions.0'"),
        (lines({"frame": 0, "positions": [["a", 0, 0], None]}), "line 2.*positions.0.0.*'a'"),
        (lines({"frame": 0.5, "positions": [None, None]}), "line 2.*'frame'.*0.5"),
        (lines({"frame": 0, "positions": [[0, 0, float("nan")], None]}), "positions.0.2'.*finite"),
        (lines(GOOD, {"positions": [None, None]}), "not every line has a 'frame'"),
        (lines({"positions": [None, None]}), "neither frame"),
        (lines(GOOD, unit="mm", frame="moon"), "'moon'"),
        (lines(GOOD, joints=None), "line 1, key 'joints'"),
        (lines(GOOD, surprise=1), "line 1.*'surprise'"),
        (lines(GOOD) + "[1]\n", "line 3.*list"),
        (lines(GOOD) + "{", "line 3.*not JSON"),
        (lines(), "shape"),
        ("", "key 'format'"),
    ],
)
def test_a_bad_line_is_named(tmp_path, text, message):
    path = tmp_path / "poses.jsonl"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        load_predictions(path)


def test_files_of_other_kinds(tmp_path):
    (tmp_path / "poses.npz").write_bytes(b"PK")
    (tmp_path / "poses.pkl").write_bytes(b"x")
    np.savez(tmp_path / "pickled.npz", positions=np.array([{}], object))
    messages = {"poses.npz": "npz", "poses.pkl": ".npz, .jsonl", "pickled.npz": "plain arrays",
                "none.jsonl": "no such file"}  # fmt: skip
    for name, message in messages.items():
        with pytest.raises(FileError, match=message):
            load_predictions(tmp_path / name)
