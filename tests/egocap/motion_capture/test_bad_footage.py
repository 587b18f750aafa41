"""Footage as it goes wrong: files that end early, break, do not fit, or fill the disk."""

import json
import os
import shutil

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.cli import main
from egocap.data.sequence import Sequence
from egocap.geometry import axis_angle


@pytest.fixture
def mocap(monkeypatch, capsys, footage, tmp_path):
    """Runs the command on a copy of the footage, which a test may damage; exit code and output."""
    place = shutil.copytree(footage, tmp_path / "footage")

    def run(*more):
        words = [*(str(place / name) for name in ("left", "right")), "--rig",
                 str(place / "rig.json"), "--fps", "30", "--out", str(tmp_path / "me"),
                 "--body", "average:1.79", "--skip-film", *more]  # fmt: skip
        monkeypatch.setattr("sys.argv", ["egocap", "mocap", *words])
        code = main()
        return code, capsys.readouterr()

    run.place, run.sequence = place, tmp_path / "me" / "sequence"
    return run


def test_a_shorter_file_and_a_damaged_picture(mocap):
    (mocap.place / "right" / "006.png").unlink()
    (mocap.place / "left" / "003.png").write_bytes(b"\x89PNG not a picture")
    code, shown = mocap("--json")
    views = json.loads(shown.out)["views"]
    assert code == 0 and (views["left"]["damaged"], views["right"]["damaged"]) == (1, 0)
    present = Sequence(mocap.sequence).frame_times.present
    assert present.shape == (6, 2) and np.argwhere(~present).tolist() == [[3, 0]]


def test_a_camera_that_dies_leaves_the_other(mocap):
    for number in (3, 4, 5, 6):
        (mocap.place / "right" / f"{number:03d}.png").unlink()
    code, shown = mocap("--keep-single", "--json")
    assert code == 0 and json.loads(shown.out)["frames"] == 7
    assert not Sequence(mocap.sequence).frame_times.present[3:, 1].any()


def test_the_rig_of_other_cameras_is_told_by_what_the_views_see(mocap):
    path = mocap.place / "rig.json"
    rig = json.loads(path.read_text())
    right = np.array(rig["mounts"][1]["T_head_camera"])
    right[:3, :3] = right[:3, :3] @ axis_angle(np.array([1.0, 0.0, 0.0]), np.deg2rad(12.0))
    rig["mounts"][1]["T_head_camera"] = right.tolist()
    path.write_text(json.dumps(rig))
    code, shown = mocap()
    assert code == 0 and "rig file does not describe these cameras" in shown.out


def test_pictures_of_another_shape_than_the_rigs_are_refused(mocap):
    path = mocap.place / "rig.json"
    rig = load_rig(path)
    camera = rig.cameras[0]
    path.write_text(json.dumps(rig.resized(camera.width, camera.height // 2).to_dict()))
    code, shown = mocap()
    assert code == 2 and "aspect ratio" in shown.err
    assert f"{camera.width} x {camera.height} " in shown.err
    assert f"{camera.width} x {camera.height // 2}" in shown.err


def test_results_never_go_into_a_sequence(mocap):
    sequence = mocap.sequence.parent
    sequence.mkdir()
    for name in ("manifest.json", "body.json"):
        (sequence / name).write_text("{}")
    code, shown = mocap()
    assert code == 2 and "is itself a sequence" in shown.err
    assert (sequence / "body.json").read_text() == "{}" and not mocap.sequence.exists()


def test_no_common_time_is_refused(mocap):
    code, shown = mocap("--lag", "60")
    assert code == 2 and "no time in common" in shown.err


@pytest.mark.parametrize("writes", [1, 6])
def test_a_full_disk_is_said_and_the_same_command_goes_on(mocap, monkeypatch, writes):
    count, sync = [0], os.fsync

    def fill(file):
        count[0] += 1
        if count[0] > writes:
            raise OSError(28, "No space left on device")
        sync(file)

    with monkeypatch.context() as full:
        full.setattr("os.fsync", fill)
        code, shown = mocap()
    assert code == 1 and "the disk is full; free some space" in shown.err.replace(" (", "; ")
    assert not [p for p in mocap.place.parent.rglob("*") if ".tmp" in p.name]
    if writes > 1:
        assert mocap()[0] == 0
