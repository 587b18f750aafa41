"""egocap-eval pose --dataset, from a miniature on disk to numbers and a submission."""

import json
import pickle
import zipfile

import numpy as np
import pytest

from egocap.body.joint_names import JOINT_ORDER
from egocap.datasets.calibration import SHIPPED
from egocap.datasets.catalogue import open_dataset
from egocap.evaluation.predictions import Predictions, save_predictions
from egocap_eval.cli import main

FRAMES = 5


@pytest.fixture
def root(tmp_path):
    """Two sequences of EgoWholeMocap; their images are not looked at."""
    rng = np.random.default_rng(0)
    rows = {
        name: [{"img_path": f"{name}/{t}.png",
                "mo2cap2_local_joints": rng.uniform([-0.5, -0.5, 0.3], [0.5, 0.5, 1.5], (15, 3))}
               for t in range(FRAMES)]
        for name in ("dance", "walk")
    }  # fmt: skip
    (tmp_path / "labels.pkl").write_bytes(pickle.dumps({"data_list": {"adanna": rows}}))
    return tmp_path


def predict(root, folder, offset=0.02):
    """The labels moved 20 mm, a file a sequence."""
    for recording in open_dataset(f"egowholemocap:{root}"):
        labels = recording.labels
        joints = labels.joints_head + [offset, 0.0, 0.0]
        path = folder / f"{recording.name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        frames = np.arange(len(recording))
        save_predictions(path, Predictions(joints, labels.labelled, "head", "m", frames))


def run(capsys, *words):
    code = main(["pose", *map(str, words)])
    return code, capsys.readouterr()


def test_one_sequence(root, tmp_path, capsys):
    predict(root, tmp_path / "mine")
    code, printed = run(capsys, "--dataset", f"egowholemocap:{root}", "--sequence", "adanna/walk",
                        "--predictions", tmp_path / "mine/adanna/walk.npz", "--json")  # fmt: skip
    result = json.loads(printed.out)
    assert code == 0 and result["protocol"] == "mo2cap2-15"
    assert result["mpjpe_mm"] == pytest.approx(20.0) and result["pa_mpjpe_mm"] < 1e-6


def test_all_sequences_and_the_submission(root, tmp_path, capsys):
    predict(root, tmp_path / "mine")
    code, printed = run(capsys, "--dataset", f"egowholemocap:{root}", "--predictions",
                        tmp_path / "mine", "--submission", tmp_path / "poses.pkl",
                        "--protocol", "mo2cap2-15-pa")  # fmt: skip
    assert code == 0 and "EgoWholeMocap" in printed.out and "adanna/dance" in printed.out
    poses = pickle.loads((tmp_path / "poses.pkl").read_bytes())
    assert len(poses) == 2 * FRAMES and poses[0].shape == (15, 3)


def test_withheld_labels_give_only_a_submission(tmp_path, capsys):
    for side in ("left", "right"):
        text = (SHIPPED / "camera_front_left.json").read_text()
        folder = tmp_path / f"UE/a/fisheye_final_image/camera_{side}"
        folder.mkdir(parents=True)
        (tmp_path / f"UE/camera_{side}.json").write_text(text)
        for t in range(3):
            (folder / f"final_{t}.png").touch()
    joints = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 18, 3))
    found = Predictions(joints, np.ones((3, 18), bool), "head", "m", np.arange(3))
    save_predictions(tmp_path / "mine.npz", found)
    words = ("--dataset", f"unrealego2:{tmp_path}/UE", "--predictions", tmp_path / "mine.npz")
    code, printed = run(capsys, *words, "--submission", tmp_path / "poses.zip")
    assert code == 0 and "1 sequences, not scored" in printed.out
    with zipfile.ZipFile(tmp_path / "poses.zip") as archive:
        pose = json.loads(archive.read("UnrealEgoData2_test_pose/a/json/frame_2.json"))
    assert list(pose) == list(JOINT_ORDER["unrealego"])
    code, printed = run(capsys, *words)
    assert code == 2 and "no labels to score against" in printed.err


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--predictions", "x.npz"], "no sequence"),
     (["SEQ", "--dataset", "unrealego:x", "--predictions", "x.npz"], "--dataset together with SEQ"),
     (["--dataset", "coco:x", "--predictions", "x.npz"], "no data set 'coco:x'"),
     (["--dataset", "unrealego:x"], "0 results to score")],
)  # fmt: skip
def test_usage_errors(words, message, capsys):
    code, printed = run(capsys, *words)
    assert code == 2 and message in printed.err
