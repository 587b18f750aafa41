"""egocap as a user runs it on a generated sequence."""

import dataclasses
import json
import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from egocap import cli
from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.data.detections import load_detections, save_detections
from egocap.data.manifest import load_manifest
from egocap.data.sequence import Sequence
from egocap.data.track import load_track
from egocap.errors import MachineError
from egocap.track.online import OnlineTracker


def complaint(result: tuple[int, str, str]) -> str:
    """The one line on stderr of a command that was asked something wrong."""
    code, out, err = result
    assert (code, out) == (2, ""), err
    assert len(err.splitlines()) == 1 and err.startswith("egocap: "), err
    return err


@pytest.fixture(scope="session")
def tracked(tiny_sequence: Path, tmp_path_factory) -> Path:
    """A folder with det.npz and track.npz of the small sequence."""
    folder = tmp_path_factory.mktemp("tracked")
    with pytest.MonkeyPatch.context() as patch:
        words = ["track", tiny_sequence, "--detections", "simulated:1.0", "--out",
                 folder / "track.npz", "--save-detections", folder / "det.npz"]  # fmt: skip
        patch.setattr(sys, "argv", ["egocap", *map(str, words)])
        assert cli.main() == 0
    return folder


def test_a_track_is_near_the_truth_and_names_its_sequence(tracked, tiny_sequence):
    track, sequence = load_track(tracked / "track.npz"), Sequence(tiny_sequence)
    error = np.linalg.norm(track.joints_head - sequence.truth.joints_head, axis=-1)
    assert np.median(error) < 0.05
    assert track.config["sequence"] == load_manifest(tiny_sequence).config_sha256
    assert track.config["detections"] == "simulated:1.0"
    assert track.config["body"] == "sequence"


def test_saved_detections_give_the_same_track(egocap, tracked, tiny_sequence):
    code, out, _ = egocap("track", tiny_sequence, "--detections", tracked / "det.npz",
                          "--out", "again.npz", "--json")  # fmt: skip
    assert code == 0 and json.loads(out)["frames"] == 7
    first, again = load_track(tracked / "track.npz"), load_track("again.npz")
    assert np.array_equal(first.joints_head, again.joints_head)


def test_the_seed_is_of_the_noise(egocap, tracked, tiny_sequence):
    for seed in (0, 1):
        words = ("--out", "t.npz", "--save-detections", f"{seed}.npz", "--seed", seed)
        assert egocap("track", tiny_sequence, "--detections", "simulated:1.0", *words)[0] == 0
    first, same, other = (load_detections(p) for p in (tracked / "det.npz", "0.npz", "1.npz"))
    assert np.array_equal(first.points, same.points, equal_nan=True)
    assert not np.array_equal(first.points, other.points, equal_nan=True)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--detections heatmap", "unknown source of detections 'heatmap' (valid: simulated:SIGMA"),
        ("--detections simulated:-1", "sigma -1.0"),
        ("--detections none.npz", "none.npz: no such file"),
        ("--detections simulated:1 --seed -1", "seed -1 (valid: 0 or more)"),
        ("--detections simulated:1 --advanced --lambda-pose nan", "lambda_pose"),
        ("--detections simulated:1 --out taken", "taken: is a folder"),
        ("--detections simulated:1 --out file/t.npz", "file: is not a folder"),
    ],
)
def test_impossible_requests(egocap, tiny_sequence, words, says):
    Path("taken").mkdir()
    Path("file").write_text("")
    out = () if "--out" in words else ("--out", "t.npz")
    assert says in complaint(egocap("track", tiny_sequence, *words.split(), *out))
    assert sorted(p.name for p in Path().iterdir()) == ["file", "taken"]
    assert not list(Path("taken").iterdir())


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: {"times": d.times + 1.0}, "different times in frame 0"),
        (lambda d: {k: getattr(d, k)[:4] for k in ("times", *ARRAYS)}, "has 4 frames"),
        (lambda d: {k: getattr(d, k)[:, :1] for k in ARRAYS}, "detections of 1 views"),
        (lambda d: {"points": d.points * np.nan}, "key 'points'"),
    ],
)
def test_detections_of_something_else(egocap, tracked, tiny_sequence, change, says):
    found = load_detections(tracked / "det.npz")
    save_detections("d.npz", dataclasses.replace(found, **change(found)))
    words = ("track", tiny_sequence, "--detections", "d.npz", "--out", "t.npz")
    assert says in complaint(egocap(*words))
    assert not Path("t.npz").exists()


ARRAYS = ("points", "sigma", "confidence", "valid")


@pytest.mark.parametrize("name", ["manifest.json", "rig.json", "body.json", "truth.npz"])
def test_a_sequence_without_one_of_its_files(egocap, tiny_sequence, name):
    shutil.copytree(tiny_sequence, "seq")
    (Path("seq") / name).unlink()
    line = complaint(egocap("track", "seq", "--detections", "simulated:1", "--out", "t.npz"))
    assert name in line and not Path("t.npz").exists()


def test_a_track_of_another_sequence_is_not_scored(tracked, tiny_sequence, tmp_path, capsys):
    from egocap_eval.cli import main

    shutil.copytree(tiny_sequence, tmp_path / "other")
    path = tmp_path / "other" / "manifest.json"
    digest = load_manifest(tiny_sequence).config_sha256
    path.write_text(path.read_text().replace(digest, "0" * 64))
    words = ["--track", str(tracked / "track.npz")]
    assert main(["pose", str(tiny_sequence), *words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 7
    assert main(["pose", str(tmp_path / "other"), *words]) == 2
    assert "track.npz: the track was made from another sequence" in capsys.readouterr().err


def test_a_body_is_fitted_and_reported(egocap, tracked, tiny_sequence):
    found = ["--detections", tracked / "det.npz"]
    code, out, err = egocap("fit-body", tiny_sequence, "--out", "body.json", *found, "--json")
    assert code == 0, err
    body, told = Proportions.load("body.json"), json.loads(out)
    assert told["bones"]["left_elbow"]["length_m"] == pytest.approx(
        body.bone_lengths["left_elbow"], abs=1e-4
    )
    wrong = ("fit-body", tiny_sequence, "--out", "b.json", *found, "--height", "178")
    assert "height of 178" in complaint(egocap(*wrong))


def test_a_rig_that_shows_nothing_new_is_written_as_it_is(egocap, tiny_sequence):
    code, out, err = egocap("correct-rig", tiny_sequence, "--out", "same.json", "--json")
    assert code == 0, err
    assert json.loads(out) == {"rig": "same.json", "corrections": {}}
    assert load_rig("same.json").mounts == Sequence(tiny_sequence).rig.mounts
    code, out, _ = egocap("correct-rig", tiny_sequence, "--out", "same.toml")
    assert code == 0 and "nothing found" in out


def test_a_rig_is_fitted_and_reported(egocap, tracked, tiny_sequence):
    found = ["--detections", tracked / "det.npz", "--neutral", 0, 1, "--frames", 8]
    words = ("fit-rig", tiny_sequence, "--out", "rig.toml", *found, "--body", "body.json")
    code, out, err = egocap(*words, "--json")
    assert code == 0, err
    told, given = json.loads(out), Sequence(tiny_sequence).rig
    assert list(told["mount"]) == ["roll", "pitch", "yaw", "forward", "left", "up"]
    fitted = load_rig("rig.toml")
    assert fitted.cameras == given.cameras
    moved = np.linalg.norm(fitted.T_head_camera[0, :3, 3] - given.T_head_camera[0, :3, 3])
    assert 0.0 < moved < 0.2
    Proportions.load("body.json")
    code, out, _ = egocap(*words)
    assert code == 0 and "pitch" in out
    track = ("track", tiny_sequence, *found[:2], "--no-appearance-check")
    assert egocap(*track, "--out", "own.npz")[0] == 0
    assert egocap(*track, "--rig", "rig.toml", "--out", "fitted.npz")[0] == 0
    own, other = (load_track(Path(f"{name}.npz")).joints_head for name in ("own", "fitted"))
    assert 0.25 * moved < np.linalg.norm(own - other, axis=-1).mean() < 0.3


def test_rigs_are_converted_and_checked(egocap, tiny_sequence):
    rig = Sequence(tiny_sequence).rig
    code, out, err = egocap("rig", "convert", tiny_sequence / "rig.json", "chain.yaml",
                            "--format", "kalibr")  # fmt: skip
    assert code == 0, err
    code, out, err = egocap("rig", "convert", "chain.yaml", "guess.toml")
    assert code == 0 and "guessed" in out, err
    mount = (0.37, 0.175, 0.14, 90, 0, 0)
    assert egocap("rig", "convert", "chain.yaml", "my.toml", "--mount", *mount)[0] == 0
    np.testing.assert_allclose(load_rig("my.toml").T_head_camera, rig.T_head_camera, atol=1e-6)
    assert egocap("rig", "check", "my.toml")[0] == 0
    fast = Path("my.toml").read_text().replace("frame_rate = 30.0", "frame_rate = 60.0")
    Path("fast.toml").write_text(fast)
    assert egocap("rig", "convert", "fast.toml", "again.toml", "--mount", *mount)[0] == 0
    assert load_rig("again.toml").frame_rate == 60.0
    flipped = (0.37, 0.175, 0.14, -90, 0, 0)
    egocap("rig", "convert", "chain.yaml", "up.toml", "--mount", *flipped)
    code, out, _ = egocap("rig", "check", "up.toml")
    assert code == 3 and "degrees up" in out
    assert "valid: rig, kalibr" in complaint(egocap("rig", "convert", "chain.yaml", "x.abc"))
    assert "egocap rig convert" in complaint(egocap("rig", "check", "chain.yaml"))


def test_a_converted_rig_can_be_read(egocap, tiny_sequence):
    assert egocap("rig", "convert", tiny_sequence / "rig.json", "ros.yaml", "--format", "ros",
                  )[0] == 0  # fmt: skip
    (one,) = Path().glob("ros*left*.yaml")
    named = re.sub("camera_name: .*", "camera_name: stereo/left", one.read_text())
    one.write_text(named)
    code, _, err = egocap("rig", "convert", one, "ros.toml")
    assert code == 0 and load_rig("ros.toml").views == ("stereo_left",), err
    assert egocap("rig", "convert", tiny_sequence / "rig.json", "mm.yaml", "--format", "kalibr",
                  )[0] == 0  # fmt: skip
    mount = (0.37, 0.175, 0.14, 90, 0, 0)
    far = re.sub(r"(T_cn_cnm1:.*?)0\.35", r"\g<1>350.0", Path("mm.yaml").read_text(), flags=re.S)
    Path("mm.yaml").write_text(far)
    assert "more than 2 m" in complaint(
        egocap("rig", "convert", "mm.yaml", "mm.toml", "--mount", *mount)
    )
    assert not Path("mm.toml").exists()


def test_a_track_is_of_the_body_it_is_given(egocap, tracked, tiny_sequence, tmp_path):
    own = Sequence(tiny_sequence).body
    dataclasses.replace(own, offsets=1.1 * own.offsets).save(tmp_path / "taller.json")
    for name, body in (("own", tiny_sequence / "body.json"), ("taller", tmp_path / "taller.json")):
        code, _, err = egocap("track", tiny_sequence, "--detections", tracked / "det.npz",
                              "--body", body, "--out", f"{name}.npz")  # fmt: skip
        assert code == 0, err
    arm = [LABELS.index(f"left_{part}") for part in ("elbow", "wrist")]

    def forearm(path: Path) -> np.ndarray:
        return np.linalg.norm(np.diff(load_track(path).joints_head[:, arm], axis=1), axis=-1)

    np.testing.assert_allclose(forearm(tmp_path / "own.npz"), forearm(tracked / "track.npz"))
    np.testing.assert_allclose(
        forearm(tmp_path / "taller.npz"), 1.1 * forearm(tmp_path / "own.npz"), rtol=1e-5
    )
    said = complaint(egocap("track", tiny_sequence, "--detections", tracked / "det.npz",
                            "--body", "none.json", "--out", "x.npz"))  # fmt: skip
    assert "none.json" in said


def test_the_solver_of_the_paper_is_a_word(egocap, tracked, tiny_sequence):
    words = ("track", tiny_sequence, "--detections", tracked / "det.npz", "--out", "paper.npz")
    code, out, err = egocap(*words, "--solver", "stochastic", "--json")
    assert code == 0, err
    found = load_track("paper.npz")
    assert found.config["paper"]["iterations"] == 50
    assert found.config["solver"] == "stochastic"
    assert json.loads(out)["frames_per_second"] == pytest.approx(1 / found.seconds_per_frame)
    wrong = egocap(*words, "--solver", "reference", "--advanced", "--lambda-motion", "0.5")
    assert "lambda_motion = 0.5 with solver 'reference'" in complaint(wrong)


@pytest.fixture
def films(tiny_sequence, tmp_path):
    """The small sequence as one video a view, its rig and body, in the folder of the test."""
    import cv2

    sequence = Sequence(tiny_sequence)
    for v, view in enumerate(sequence.rig.views):
        fourcc = cv2.VideoWriter.fourcc(*"MJPG")
        writer = cv2.VideoWriter(str(tmp_path / f"{view}.avi"), fourcc, 5.0, (160, 128))
        if not writer.isOpened():
            pytest.skip("no video writer here")
        for t in range(len(sequence)):
            writer.write(sequence.frame(t).images[v][..., ::-1])
        writer.release()
    return tuple(f"{view}.avi" for view in sequence.rig.views)


def test_an_imported_sequence_gets_another_clock_without_its_sources(egocap, films, tiny_sequence):
    words = ("import", *films, "--rig", tiny_sequence / "rig.json", "--out", "clip")
    assert egocap(*words)[0] == 0
    code, out, err = egocap("import", "--out", "clip", "--lag", 0.2, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["views"]["right"]["timing"]["offset_s"] == pytest.approx(-0.2)
    assert found["frames"] == 6  # the first picture of the left view has no partner
    assert "sources and --rig FILE" in complaint(egocap("import", "--out", "nothing"))


def test_live_by_colour_writes_a_track_and_a_film(egocap, films, tracked, tiny_sequence):
    files = ("--rig", tiny_sequence / "rig.json", "--body", tiny_sequence / "body.json")
    words = ("live", *films, *files, "--colour-only")
    made = ("--start", tracked / "track.npz", "--out", "live.npz", "--record", "live.mp4")
    code, out, err = egocap(*words, *made, "--view", "--port", 0, "--json")
    assert code == 0, err
    assert "http://127.0.0.1:" in err
    found = load_track("live.npz")
    assert json.loads(out)["poses"] == len(found.times) >= 1
    assert Path("live.mp4").stat().st_size > 5_000
    for wrong, says in (
        (("--start", "upside down"), "no initial pose 'upside down' (valid: rest"),
        (("--weights", "w.safetensors"), "--colour-only uses neither --weights"),
        (("--record", "live.gif"), "ends in .mp4"),
    ):
        assert says in complaint(egocap(*words, *wrong))
    assert "--start" in complaint(egocap("live", *films, *files, "--start", "sitting"))
    assert "1 sources" in complaint(egocap("live", films[0], *files))


def test_a_guided_fit_asks_for_poses_and_writes_a_body(egocap, films, tiny_sequence):
    words = ("fit-body", *films, "--guided", "--rig", tiny_sequence / "rig.json", "--out", "b.json")
    code, out, err = egocap(*words, "--height", 1.79, "--json")
    assert code == 0, err
    assert "now: stretch both arms forward" in err
    assert err.rstrip().endswith("; no more pictures")
    told = json.loads(out)["bones"]["left_ankle"]["length_m"]
    assert told == pytest.approx(Proportions.load("b.json").bone_lengths["left_ankle"], abs=1e-4)
    assert "sources" in complaint(egocap("fit-body", films[0], *words[3:]))
    assert "--guided without --rig" in complaint(egocap(*words[:4], *words[6:]))
    assert "--shape with --guided" in complaint(egocap(*words, "--shape", "s.json"))
    assert "simulated:2" in complaint(egocap(*words, "--detections", "simulated:2"))
    assert "--rig without --guided" in complaint(
        egocap("fit-body", tiny_sequence, "--rig", "r.json", "--out", "b.json")
    )
    assert "2 sequences" in complaint(egocap("fit-body", *films, "--out", "b.json"))


def test_live_of_files_tracks_every_frame_for_an_animation(egocap, films, tiny_sequence):
    words = ("live", *films, "--rig", tiny_sequence / "rig.json", "--body", "average:1.79")
    code, out, err = egocap(*words, "--out", "live.npz", "--json")
    assert code == 0, err
    summary = json.loads(out)
    assert (summary["poses"], summary["skipped_pictures"]) == (7, 0)
    np.testing.assert_allclose(load_track("live.npz").times, np.arange(7) / 5.0, atol=1e-3)
    assert egocap("export", "live.npz", "--out", "new/live.bvh")[0] == 0
    assert "is a folder" in complaint(egocap(*words, "--out", "."))
    assert "live without --rig and --body" in complaint(egocap("live", *films))


def test_live_in_the_world_says_where_it_does_not_know(egocap, films, tiny_sequence):
    words = ("live", *films, "--rig", tiny_sequence / "rig.json", "--body", "average:1.79")
    code, out, err = egocap(*words, "--out", "live.npz", "--world", "--json")
    assert code == 0, err
    world = json.loads(out)["world"]
    assert world["frames"] == 7 == world["posed"] + sum(world["without"].values())
    track = load_track("live.npz")
    known = 0 if track.in_world is None else track.in_world.sum()
    assert known == world["posed"] and track.config["live"]["world"] == world
    assert "no head pose in" in egocap(*words, "--world")[1]
    assert "--world requires a detector" in complaint(egocap(*words, "--world", "--colour-only"))
    assert "without --world" in complaint(egocap(*words, "--no-self-calibration"))


def test_a_live_run_that_fails_keeps_the_track(egocap, films, tiny_sequence, monkeypatch):
    step, seen = OnlineTracker.step, []

    def fails_late(tracker, *found):
        if len(seen) == 3:
            raise MachineError("the camera was unplugged")
        seen.append(step(tracker, *found))
        return seen[-1]

    monkeypatch.setattr("egocap.view.live_run.warm_up", lambda detector, tracker: None)
    monkeypatch.setattr(OnlineTracker, "step", fails_late)
    words = ("--rig", tiny_sequence / "rig.json", "--body", "average:1.79", "--out", "live.npz")
    assert "unplugged" in egocap("live", *films, *words)[2]
    assert len(load_track("live.npz").times) == sum(map(len, seen)) > 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("realtime", [False, True])
def test_a_signal_ends_a_live_run_and_keeps_the_track(
    number, realtime, egocap, films, tiny_sequence, monkeypatch
):
    from egocap.detect.detector import Detector

    count, detect = [0], Detector.detect_images

    def interrupted(self, images, when=0.0):
        count[0] += 1
        if count[0] == 3:  # of the second frame: the first is the warm-up
            os.kill(os.getpid(), number)  # to the main thread, as from outside
            time.sleep(0.05)
        return detect(self, images, when)

    monkeypatch.setattr(Detector, "detect_images", interrupted)
    before = signal.getsignal(number)
    words = ("--rig", tiny_sequence / "rig.json", "--body", "average:1.79", "--out", "live.npz")
    code, out, err = egocap("live", *films, *words, *["--realtime"] * realtime, "--json")
    assert code == (0 if realtime else 130), err  # cameras have no end of their own
    assert json.loads(out)["poses"] == len(load_track("live.npz").times) == 2
    assert signal.getsignal(number) == before


def test_cameras_are_listed(egocap):
    code, out, _ = egocap("live", "--list", "--json")
    assert code == 0 and isinstance(json.loads(out), list)
