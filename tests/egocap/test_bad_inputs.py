"""What a user may hand over by mistake: one line that says what is wrong, or a sound result."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap.data.detections import load_detections, save_detections
from egocap.data.sequence import Sequence
from egocap.data.track import load_track, save_track
from egocap.errors import InputError
from egocap.fitting.fit_body import fit_body
from egocap.paper.tracker import PaperTracker
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker
from tests.egocap.cli.test_cli import complaint, tracked
from tests.egocap.conftest import make_motion

__all__ = ["tracked"]  # a fixture


def rewritten(source: Path, target: str, **changes) -> str:
    """A copy of a track with arrays replaced."""
    with np.load(source / "track.npz") as archive:
        np.savez(target, **(dict(archive) | changes))
    return target


@pytest.mark.parametrize("array", ["angles", "joints_head", "offsets"])
def test_a_track_of_another_skeleton(egocap, tracked, tiny_sequence, array):
    with np.load(tracked / "track.npz") as archive:
        fewer = archive[array][..., :-4, :] if array != "angles" else archive[array][:, :30]
    other = rewritten(tracked, "other.npz", **{array: fewer})
    view = ("draw-model", tiny_sequence, "--track", other, "--out", "v.png")
    for words in (("export", other, "--out", "o.bvh"), view):
        assert array in complaint(egocap(*words))
    assert not Path("o.bvh").exists() and not Path("v.png").exists()


@pytest.mark.parametrize("value", [np.nan, 1e300])
@pytest.mark.parametrize("array", ["angles", "joints_head", "confidence", "times"])
def test_a_track_with_a_value_that_is_no_number(egocap, tracked, array, value):
    with np.load(tracked / "track.npz") as archive:
        values = archive[array].copy()
    values.flat[-1] = value
    other = rewritten(tracked, "nan.npz", **{array: values})
    line = complaint(egocap("export", other, "--out", "o.npz", "--format", "npz"))
    assert f"key '{array}'" in line and "not finite" in line


@pytest.mark.parametrize("solver", [("--solver", "stochastic"), ("--colour",)])
def test_pictures_of_another_aspect_than_the_rig(egocap, tracked, tiny_sequence, solver):
    shutil.copytree(tiny_sequence, "seq")
    rig = load_rig("seq/rig.json").resized(160, 96)
    Path("seq/rig.json").write_text(json.dumps(rig.to_dict()))
    words = ("track", "seq", "--detections", tracked / "det.npz", "--out", "t.npz", *solver)
    line = complaint(egocap(*words))
    assert "has 160 x 128 pixels" in line and "160 x 96" in line
    assert not Path("t.npz").exists()


@pytest.mark.parametrize(("file", "key"), [("body.json", "bones"), ("rig.json", "cameras")])
def test_a_body_or_rig_with_a_value_that_is_no_number(egocap, tiny_sequence, tracked, file, key):
    shutil.copytree(tiny_sequence, "seq")
    text = (Path("seq") / file).read_text()
    first = next(w for w in text.replace("[", " ").replace(",", " ").split() if "." in w
                 and w.lstrip("-").replace(".", "").isdigit())  # fmt: skip
    (Path("seq") / file).write_text(text.replace(first, "NaN", 1))
    line = complaint(egocap("track", "seq", "--detections", tracked / "det.npz", "--out", "t.npz"))
    assert file in line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("export seq --out o.bvh", "seq: a folder (valid: a track or detections, npz)"),
        ("export t.npz --out t.npz", "t.npz: the output would replace the input 'track'"),
        ("export t.npz --out link.npz", "replace the input 'track'"),
        ("track seq --detections d.npz --out d.npz", "replace the input 'detections'"),
        ("track seq --detections d.npz --out o.npz --save-detections o.npz", "two outputs in one"),
        ("rig convert seq/rig.json seq/rig.json --format colmap", "replace the input 'source'"),
    ],
)
def test_an_output_that_would_replace_an_input(egocap, tracked, tiny_sequence, words, says):
    Path("seq").symlink_to(tiny_sequence)
    shutil.copy(tracked / "track.npz", "t.npz")
    shutil.copy(tracked / "det.npz", "d.npz")
    Path("link.npz").symlink_to("t.npz")
    before = {path: path.read_bytes() for path in Path().glob("*.npz")}
    assert says in complaint(egocap(*words.split()))
    assert {path: path.read_bytes() for path in Path().glob("*.npz")} == before


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("rig convert seq/rig.json o.toml --size -1 5", "--size -1 5 (valid: 1 to"),
        ("rig show seq/rig.json --out o.png --poses 999999999999", "999999999999 poses"),
        ("rig show seq/rig.json --out o.png --sigma 1e-300 --poses 5", "sigma 1e-300"),
        ("head-pose seq --out o.npz --trajectory seq/rig.json --format nope", "no format 'nope'"),
        ("fit-rig seq --out o.toml --detections simulated:1 --position-error nan", "mount error"),
        ("fit-rig seq --out o.toml --detections simulated:1 --rotation-error 1e300", "mount error"),
        ("fit-rig seq --out o.toml --detections simulated:1 --body seq", "seq: is a folder"),
        ("mocap seq seq --rig seq/rig.json --out o --fps 1e300", "--fps 1e+300"),
        ("adapt seq --out o --minutes nan", "--minutes nan (valid: above 0"),
        ("adapt seq --out o --steps -5", "--steps -5"),
        ("adapt seq --out o --learning-rate -1", "--learning-rate -1"),
        ("adapt seq --out o --height 9", "a height of 9.0 m"),
        ("adapt seq --out o --seed -1", "--seed -1"),
        ("live a b --rig seq/rig.json --body average:1.7 --size 0 0", "--size 0 0"),
        ("live a b --rig seq/rig.json --body average:1.7 --fps nan", "--fps nan"),
        (
            "live 98 99 --rig seq/rig.json --body average:1.7",
            "'98' (valid: a video file, or a number of egocap live",
        ),
        ("live 0 1 --rig seq/rig.json", "live without --body (valid"),
        ("live 0 1 --body average:1.7", "live without --rig (valid"),
        ("live 0 1", "live without --rig and --body (valid"),
        (
            "view walk.mp4 --save o.mp4",
            "walk.mp4: cannot be viewed (valid: a sequence, which egocap import",
        ),
        ("rig check egorig1", "the built-in rigs are for egocap-sim"),
        ("rig convert egorig1 o.toml", "egorig1: no such file (valid: a rig file"),
        ("import a.mp4 --rig egorig1 --out o", "egorig1: no such file (valid: a rig file"),
        ("export t.npz --out /proc/o.bvh", "cannot write /proc/"),
    ],
)
def test_numbers_and_files_that_cannot_be(egocap, tracked, tiny_sequence, words, says):
    Path("seq").symlink_to(tiny_sequence)
    shutil.copy(tracked / "track.npz", "t.npz")
    code, out, err = egocap(*words.split())
    assert code == (1 if "/proc/" in words else 2) and not out, err
    assert says in err and len(err.splitlines()) == 1, err
    assert not [path for path in Path().iterdir() if path.name.startswith("o")]


@pytest.mark.parametrize("name", ['a"b', "a\n[x]\ny = 1", "\x7f\x1b[31m", "\\"])
def test_names_of_rigs_with_any_characters_are_kept(egocap, tiny_sequence, name):
    data = json.loads((tiny_sequence / "rig.json").read_text()) | {"name": name}
    Path("rig.json").write_text(json.dumps(data))
    code, out, _ = egocap("rig", "convert", "rig.json", "rig.toml")
    assert code == 0 and len(out.splitlines()) == 1 and "\x1b" not in out
    assert load_rig("rig.toml").name == name


def test_names_of_cameras_stay_in_the_folder(egocap, tiny_sequence):
    assert (
        egocap("rig", "convert", tiny_sequence / "rig.json", "a.json", "--format", "aria")[0] == 0
    )
    data = json.loads(Path("a.json").read_text())
    for camera, label in zip(data["CameraCalibrations"], ("../../x", "a b"), strict=True):
        camera["Label"] = label
    Path("a.json").write_text(json.dumps(data))
    assert egocap("rig", "convert", "a.json", "o.yaml", "--format", "ros")[0] == 0
    assert sorted(p.name for p in Path().glob("o.*")) == ["o._x.yaml", "o.a_b.yaml"]


def test_aliases_of_yaml_that_make_gigabytes_are_refused(egocap):
    bomb = "a0: &a0 [x, x]\n" + "".join(
        f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 40)
    )
    Path("chain.yaml").write_text(bomb)
    assert "aliases" in complaint(egocap("rig", "convert", "chain.yaml", "o.toml"))
    Path("chain.yaml").write_text("cam0: &a {inside: *a}\n")
    assert "holds itself" in complaint(egocap("rig", "convert", "chain.yaml", "o.toml"))


def nothing_found(found):
    return dataclasses.replace(
        found, valid=np.zeros_like(found.valid), points=np.full_like(found.points, np.nan)
    )


def test_no_detections_at_all(egocap, tracked, tiny_sequence):
    save_detections("none.npz", nothing_found(load_detections(tracked / "det.npz")))
    words = (tiny_sequence, "--detections", "none.npz", "--out")
    code, _, err = egocap("track", *words, "t.npz")
    assert code == 0, err
    blind, seen = load_track("t.npz"), load_track(tracked / "track.npz")
    assert np.isfinite(blind.joints_head).all() and np.isfinite(blind.covariance).all()
    assert blind.confidence[:, 2:].mean() < 0.5 * seen.confidence[:, 2:].mean()
    assert not (blind.hidden == 0).any()
    assert "no detection" in complaint(egocap("fit-body", *words, "b.json"))
    assert not Path("b.json").exists()


def test_one_frame():
    made = make_motion(frames=1)
    found = made.detect("simulated:1")
    for smoothing in ("interval", "gaussian", "none"):
        one = Tracker(made.rig, made.person, TrackerConfig(smoothing=smoothing)).track(found)
        assert np.median(made.errors(one)) < 0.03 and one.hidden.shape == (1, 2, 18)
    fit = fit_body(found, made.rig)
    assert np.isfinite(fit.std).all() and np.isfinite(fit.proportions.offsets).all()
    assert np.mean([line["determined"] == "well" for line in fit.report().values()]) < 0.5


def test_one_frame_is_exported(egocap):
    made = make_motion(frames=1)
    save_track("one.npz", Tracker(made.rig, made.person).track(made.detect("simulated:1")))
    for out in ("one.bvh", "arrays.npz"):
        words = ("export", "one.npz", "--out", out, "--format", out[-3:])
        code, said, err = egocap(*words)
        assert code == 0 and "1 frames" in said, err


def test_one_black_camera_with_the_solvers_of_the_paper(tiny_sequence, tracked):
    sequence, found = Sequence(tiny_sequence), load_detections(tracked / "det.npz")
    found.valid[:, 1] = False
    black = np.zeros((128, 160, 3), np.uint8)
    made = PaperTracker(sequence.rig, sequence.body, "stochastic").track(
        found, lambda t: (sequence.frame(t).images[0], black)
    )
    assert np.isfinite(made.joints_head).all()
    with pytest.raises(InputError, match="1 images"):
        PaperTracker(sequence.rig, sequence.body, "stochastic").track(found, lambda t: (black,))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("posterior SEQ --frame 1 --walkers 1000000000 --out p.npz", "2,000,000 draws"),
        ("live a.mp4 b.mp4 --rig SEQ/rig.json --body average:1.7 --seconds nan", "--seconds nan"),
        ("live a.mp4 b.mp4 --rig SEQ/rig.json --body average:1.7 --port 99999", "0 to 65535"),
        ("import a b --rig SEQ/rig.json --out clip --fps 0", "--fps 0"),
        ("import a b --rig SEQ/rig.json --out clip --bits 40", "--bits 40"),
        ("import a b --rig SEQ/rig.json --out clip --gains nan 1 1", "--gains"),
        ("import a b --rig SEQ/rig.json --out clip --start nan", "--start nan"),
        ("mocap a b --rig SEQ/rig.json --out clip --height -3", "a height of -3"),
        ("mocap a b --rig SEQ/rig.json --out clip --body none.json", "none.json"),
    ],
)
def test_impossible_numbers_on_the_command_line(egocap, tiny_sequence, words, said):
    line = complaint(egocap(*words.replace("SEQ", str(tiny_sequence)).split()))
    assert said in line
    assert not Path("clip").exists()
