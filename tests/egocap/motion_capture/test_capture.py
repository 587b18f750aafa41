"""From pictures of two cameras to motion, in one call and in one command."""

import json
import shutil

import numpy as np
import pytest

from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import load_rig
from egocap.cli import main
from egocap.data.sequence import Sequence
from egocap.data.track import load_track
from egocap.geometry import inverse


def mocap(monkeypatch, capsys, footage, out, *more, order=("left", "right")):
    words = [*(str(footage / name) for name in order), "--rig", str(footage / "rig.json"),
             "--fps", "30", "--out", str(out), *more]  # fmt: skip
    monkeypatch.setattr("sys.argv", ["egocap", "mocap", *words])
    code = main()
    return code, capsys.readouterr()


@pytest.fixture(scope="module")
def results(footage, tmp_path_factory):
    """A folder of results, made once."""
    from egocap import mocap as capture
    from egocap.footage.config import ImportOptions
    from egocap.media.pictures import PictureOptions
    from egocap.motion_capture.config import MocapOptions

    out = tmp_path_factory.mktemp("results") / "me"
    options = ImportOptions(pictures=PictureOptions(fps=30.0))
    sources = [footage / "left", footage / "right"]
    capture(sources, footage / "rig.json", out, MocapOptions(height=1.79), options)
    return out


def test_everything_is_written_and_the_motion_is_near_the_truth(results, tiny_sequence):
    assert {"track.npz", "motion.bvh", "film.mp4", "index.html", "body.json", "detections.npz",
            "findings.json"} <= {path.name for path in results.iterdir()}  # fmt: skip
    track = load_track(results / "track.npz")
    error = np.linalg.norm(track.joints_head - Sequence(tiny_sequence).truth.joints_head, axis=-1)
    assert error[:, 1:].mean() < 0.06
    page = (results / "index.html").read_text()
    assert "What to improve" in page and page.count("<figure>") >= 1
    assert (results / "motion.bvh").read_text().startswith("HIERARCHY")


def test_the_command_reuses_what_is_there(monkeypatch, capsys, footage, results):
    before = {p.name: p.stat().st_mtime_ns for p in results.iterdir() if p.suffix != ".html"}
    code, shown = mocap(monkeypatch, capsys, footage, results, "--height", "1.79", "--json")
    assert code == 0
    found = json.loads(shown.out)
    assert found["frames"] == 7 and 0 < found["sure"] <= 1 and found["advice"]
    after = {name: (results / name).stat().st_mtime_ns for name in before}
    assert {n for n in before if after[n] != before[n]} <= {"findings.json", "sequence"}


def test_another_height_changes_neither_detections_nor_the_path(
    monkeypatch, capsys, footage, results, tmp_path
):  # fmt: skip
    out = shutil.copytree(results, tmp_path / "me")
    names = ("detections.npz", "rig-correction.json", "rig.json", "head.npz", "body.json",
             "track.npz")  # fmt: skip
    before = {name: (out / name).stat().st_mtime_ns for name in names}
    code, shown = mocap(monkeypatch, capsys, footage, out, "--height", "1.6", "--skip-film")
    assert code == 0, shown.err
    written = {name for name in names if (out / name).stat().st_mtime_ns != before[name]}
    assert written == {"body.json", "track.npz"}


def test_recordings_are_called_like_their_files(monkeypatch, capsys, footage, tmp_path):
    (tmp_path / "rig.json").symlink_to(footage / "rig.json")
    (tmp_path / "take").mkdir()
    order = ("run-left", "run-right", "take/left", "take/right")
    for path, view in zip(order, 2 * ("left", "right"), strict=True):
        (tmp_path / path).symlink_to(footage / view)
    code, shown = mocap(
        monkeypatch, capsys, tmp_path, tmp_path / "out", "--body", "average:1.79", "--skip-film",
        order=order,
    )  # fmt: skip
    assert code == 0 and "2 of 2 recordings" in shown.out, shown.err
    for name in ("take", "run"):
        assert len(load_track(tmp_path / "out" / name / "track.npz").times) == 7


def test_head_poses_of_other_times_are_refused_before_detection(
    monkeypatch, capsys, footage, tmp_path
):
    times = 50.0 + np.arange(9) / 30.0
    np.savez(tmp_path / "h.npz", time=times, T_world_head=np.tile(np.eye(4), (9, 1, 1)))
    code, shown = mocap(
        monkeypatch, capsys, footage, tmp_path / "o", "--head-pose", str(tmp_path / "h.npz")
    )
    assert code == 2 and "head poses from 50 to" in shown.err.splitlines()[-1]
    assert not (tmp_path / "o/detections.npz").exists()


def test_surroundings_that_cannot_be_shown_are_refused_before_detection(
    monkeypatch, capsys, footage, tmp_path
):
    times = np.arange(9) / 30.0
    np.savez(tmp_path / "h.npz", time=times, T_world_head=np.tile(np.eye(4), (9, 1, 1)),
             points=np.zeros((4, 2)))  # fmt: skip
    code, shown = mocap(
        monkeypatch, capsys, footage, tmp_path / "o", "--head-pose", str(tmp_path / "h.npz")
    )
    assert code == 2 and "key 'points': not points" in shown.err
    assert not (tmp_path / "o").exists()


def test_exchanged_views_are_refused(monkeypatch, capsys, footage, tmp_path):
    code, shown = mocap(
        monkeypatch, capsys, footage, tmp_path / "x", "--body", "average:1.79", "--skip-film",
        order=("right", "left"),
    )  # fmt: skip
    assert code == 2 and "look exchanged" in shown.err


def test_height_and_body_exclude_each_other(monkeypatch, capsys, footage, tmp_path):
    code, shown = mocap(
        monkeypatch, capsys, footage, tmp_path / "x", "--body", "me.json", "--height", "1.8"
    )
    assert code == 2 and "--height and --body" in shown.err and not (tmp_path / "x").exists()


def test_the_wearer_moves_through_the_world(monkeypatch, capsys, footage, results, tiny_sequence):
    code, _ = mocap(monkeypatch, capsys, footage, results, "--height", "1.79", "--json")
    assert code == 0
    track, truth = load_track(results / "track.npz"), Sequence(tiny_sequence).truth
    moved = inverse(track.T_world_head[0]) @ track.T_world_head
    true = inverse(truth.T_world_head[0]) @ truth.T_world_head
    np.testing.assert_allclose(moved[:, :3, 3], true[:, :3, 3], atol=0.02)
    np.testing.assert_allclose(moved[:, :3, :3], true[:, :3, :3], atol=0.02)
    assert track.contacts is not None and (results / "head.npz").exists()
    assert "Path on the floor" in (results / "index.html").read_text()
    told = json.loads((results / "findings.json").read_text())
    assert told["in_world"] == 1.0 and told["vertical"]["up_std_deg"] > 0.0


def test_without_a_path_the_motion_is_relative_to_the_head(
    monkeypatch, capsys, footage, results, tmp_path
):  # fmt: skip
    """Nor is anything of an earlier run with a path left in it."""
    out = shutil.copytree(results, tmp_path / "me")
    code, _ = mocap(monkeypatch, capsys, footage, out, "--height", "1.79", "--no-world", "--json")
    assert code == 0
    track = load_track(out / "track.npz")
    assert track.T_world_head is None and track.contacts is None
    assert "Path on the floor" not in (out / "index.html").read_text()
    told = json.loads((out / "findings.json").read_text())
    assert told["in_world"] is None and told["vertical"] is None


def test_a_given_path_is_not_sought(monkeypatch, capsys, footage, tiny_sequence, tmp_path):
    sequence = Sequence(tiny_sequence)
    truth = sequence.truth
    np.savez(tmp_path / "h.npz", time=sequence.times, T_world_head=truth.T_world_head)
    code, shown = mocap(
        monkeypatch, capsys, footage, tmp_path / "me", "--body", "average:1.79", "--skip-film",
        "--head-pose", str(tmp_path / "h.npz"),
    )  # fmt: skip
    assert code == 0, shown.err
    assert not (tmp_path / "me/head.npz").exists()
    track = load_track(tmp_path / "me/track.npz")
    np.testing.assert_allclose(track.T_world_head[:, :3, 3], truth.T_world_head[:, :3, 3], atol=0.1)


def test_one_camera_tells_no_metres_of_the_path(monkeypatch, capsys, caplog, footage, tmp_path):
    rig = load_rig(footage / "rig.json")
    Rig(rig.name, rig.mounts[:1]).to_json(tmp_path / "rig.json")
    (tmp_path / "left").symlink_to(footage / "left")
    code, _ = mocap(
        monkeypatch, capsys, tmp_path, tmp_path / "me", "--body", "average:1.79", "--skip-film",
        order=["left"],
    )  # fmt: skip
    assert code == 0 and "the motion is relative to the head" in caplog.text
    assert load_track(tmp_path / "me/track.npz").T_world_head is None
