"""egocap-sim as a user runs it, and everything a user can get wrong."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.data.manifest import SCHEMA, load_manifest
from egocap.data.sequence import Sequence
from egocap_sim import cli
from egocap_sim.core.resources import builtin_file, rig_file
from egocap_sim.scene.config import Scene, to_toml
from egocap_sim.verification.integrity import verify
from egocap_sim.world.overrides import Overrides, override_scene
from tests.egocap_sim.refinement.made_tracks import standing, track_of

GOOD = 'name = "x"\nframes = 2\n[motion]\nname = "idle"\n[rig]\nsize = [96, 64]\n'


@pytest.fixture
def sim(monkeypatch, capsys, tmp_path, no_lines_by_the_clock):
    """Run egocap-sim in an empty folder; gives its exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["egocap-sim", *map(str, words)])
        code = cli.main()
        return code, *capsys.readouterr()

    return run


def complaint(result: tuple[int, str, str], code: int = 2) -> str:
    """The one line on stderr of a command that failed as it should."""
    returned, out, err = result
    assert (returned, out) == (code, ""), err
    lines = err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("egocap-sim: "), err
    return lines[0]


def changed(**asked) -> Scene:
    return override_scene(Scene.model_validate(tomllib.loads(GOOD)), Overrides(**asked))


def test_an_image_size_of_another_shape_warns(caplog):
    changed(size=(640, 512))
    assert not caplog.records
    assert changed(size=(640, 480)).rig.size == (640, 480)
    assert "--size 640 480 stretches the images: the rig's are 1280 x 1024" in caplog.text


def test_generate_verify_and_preview(sim, tiny_scene, tiny_sequence):
    Path("tiny.toml").write_text(to_toml(tiny_scene))
    code, out, err = sim("generate", "tiny.toml", "--frames", 3, "--workers", 1, "--out", "seq")
    assert code == 0, err
    assert out.startswith("seq: 3 frames of 1 wearer, 0.") and "physics: " in out
    code, out, err = sim("verify", "seq")
    assert code == 0 and "3 frames in 2 shards" in out and "clean" in out
    assert err.startswith("verify: 3/3 frames")
    # A shorter sequence is the start of the longer one.
    for mine, other in zip(Sequence("seq"), Sequence(tiny_sequence), strict=False):
        assert np.array_equal(mine.images, other.images)
    code, out, _ = sim("preview", "seq", "--rows", 2, "--out", "new/sheet.png")
    assert (code, out) == (0, "new/sheet.png\n") and Path("new/sheet.png").stat().st_size > 1000
    code, out, _ = sim("generate", "tiny.toml", "--frames", 3, "--out", "seq", "--json")
    assert code == 0 and json.loads(out)["rendered"] == 0


def test_an_interrupted_run_is_resumed(tiny_scene, tmp_path):
    """Ctrl-C reaches the whole process group, as from a terminal."""
    (tmp_path / "tiny.toml").write_text(to_toml(tiny_scene))
    command = [sys.executable, "-m", "egocap_sim", "generate", str(tmp_path / "tiny.toml"),
               "--out", str(tmp_path / "seq"), "--frames", "300", "--workers", "2"]  # fmt: skip
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    manifest = tmp_path / "seq" / "manifest.json"
    while process.poll() is None:
        if manifest.exists() and load_manifest(tmp_path / "seq").shards:
            os.killpg(process.pid, signal.SIGINT)
            break
        time.sleep(0.05)
    out, err = process.communicate(timeout=600)
    assert (process.returncode, out) == (130, ""), err
    assert "Traceback" not in err and err.splitlines()[-1] == "egocap-sim: interrupted"
    done = load_manifest(tmp_path / "seq").shards
    assert 1 <= len(done) < 150
    assert verify(tmp_path / "seq").problems == (
        f"unfinished: {150 - len(done)} of 150 shards are not there yet",
    )


def test_verify_tells_what_is_missing_of_an_unfinished_sequence(sim, tiny_sequence):
    manifest = json.loads((tiny_sequence / "manifest.json").read_text())
    Path("seq").mkdir()
    for name in ("rig.json", "scene.toml", "body.json", "person.json"):
        (Path("seq") / name).write_bytes((tiny_sequence / name).read_bytes())
    manifest["files"].pop("truth.npz")
    Path("seq/manifest.json").write_text(json.dumps(manifest | {"shards": []}))
    code, out, err = sim("verify", "seq")
    assert (code, out, err) == (2, "", "seq: unfinished: 4 of 4 shards are not there yet\n")
    code, out, _ = sim("verify", "seq", "--json")
    assert code == 2 and json.loads(out)["problems"] and not json.loads(out)["clean"]
    assert "run the same generate command" in complaint(sim("preview", "seq", "--out", "a.png"))


def test_what_the_command_line_asks_for_wins(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").mkdir()
    shutil.copy(rig_file("cap"), tmp_path / "mine/rig.toml")
    scene = changed(frames=9, seed=7, size=(320, 256), rig="egorig2", samples=4, no_masks=True,
                       depth=True, image_format="png")  # fmt: skip
    assert (scene.frames, scene.seed, scene.rig.size) == (9, 7, (320, 256))
    assert (scene.rig.name, scene.rig.file) == ("egorig2", None)
    assert scene.record.model_dump(include={"samples", "masks", "depth", "image_format"}) == {
        "samples": 4, "masks": False, "depth": True, "image_format": "png"}  # fmt: skip
    assert changed(motion="sit").motion.name == "sit"
    motion = changed(frames=2, motion="clip.bvh", up="z", unit="cm", start=1.5).motion
    assert (motion.name, motion.file) == (None, str(Path("clip.bvh").resolve()))
    assert (motion.up, motion.unit, motion.start_s) == ("z", "cm", 1.5)
    rig = changed(rig="mine/rig.toml").rig
    assert (rig.name, rig.file) == (None, str(Path("mine/rig.toml").resolve()))
    assert changed() == changed(frames=2)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--frames 0", r"'frames': .*greater than or equal to 1"),
        ("--seed -1", r"'seed': "),
        ("--size 0 0", r"'rig\.size\.0': .*equal to 64"),
        ("--size 100000 64", r"'rig\.size\.0': .*8192"),
        ("--rig egorig9", r"no built-in rig or file 'egorig9' \(valid: cap, ego4view, egorig1"),
        ("--rig none.toml", r"none\.toml: no such file"),
        ("--rig .", "is a folder"),
        ("--motion wlak", r"no built-in motion or file 'wlak' \(valid: walk, "),
        ("--motion none.bvh", r"none\.bvh: cannot be read: No such file"),
        ("--motion .", "is a folder"),
        ("--motion good.toml", r"good\.toml: is of an unknown kind '\.toml' \(valid: \.bvh, \.npz"),
        ("--up y", "'up' is for a clip, not for the motion 'idle'"),
        ("--unit furlong", r"'motion\.unit': .*'inch'"),
        ("--samples 3", "0, 2, 4 or 8"),
        ("--image-format gif", "'jpg' or 'png'"),
        ("--start -1", r"'motion\.start_s'"),
        ("--workers -1", "-1 workers"),
    ],
)
def test_impossible_options_leave_nothing_behind(sim, words, says):
    Path("good.toml").write_text(GOOD)
    line = complaint(sim("generate", "good.toml", "--out", "seq", *words.split()))
    assert re.search(says, line), line
    assert [p.name for p in Path().iterdir()] == ["good.toml"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "key 'name': field required"),
        ("\x00\x01", "not TOML"),
        (GOOD.replace("frames = 2", "frames = true"), "'frames': .*integer, not True"),
        (GOOD.replace("frames = 2", "frames = '2'"), "'frames': .*integer, not '2'"),
        (GOOD.replace("frames = 2", "fps = nan"), "'fps': .*finite"),
        (GOOD + "fov = 3\n", r"'rig\.fov': unknown key \(valid: family, file, name, size\)"),
        (GOOD + "file = 'a.toml'\nname = 'egorig1'\n", "'rig': give either"),
        (GOOD + "[person]\nheight_m = 5\n", r"'person\.height_m': .*2\.1, not 5"),
        (GOOD + "[person.outfit]\ntop = 'cape'\n", r"'person': unknown top 'cape' \(valid: tshirt"),
        (GOOD + "[place]\nname = 'moon'\n", r"'place\.name': unknown place 'moon' \(valid: room"),
        (GOOD + "[record]\nshard_frames = 0\n", r"'record\.shard_frames'"),
        (GOOD + "[record]\nmasks = 'yes'\n", r"'record\.masks': .*boolean"),
        (GOOD.replace("idle", "wlak"), r"'motion': unknown motion 'wlak' \(valid: walk, "),
        (GOOD.replace("[rig]", "parameters = {fps = 9}\n[rig]"), "unknown parameter 'fps'"),
        (GOOD.replace("[rig]", "up = 'z'\n[rig]"), "'up' is for a clip"),
    ],
)
def test_a_wrong_scene_is_named_and_leaves_nothing_behind(sim, text, says):
    Path("wrong.toml").write_text(text)
    line = complaint(sim("generate", "wrong.toml", "--out", "seq"))
    assert line.startswith("egocap-sim: wrong.toml")
    assert re.search(says, line), line
    assert not Path("seq").exists()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("fov = 0", r"'lens\.fov': .*greater than 0, not 0"),
        ("baseline = -0.35", r"'stereo\.baseline': .*greater than 0, not -0\.35"),
        ("model = 'pinhole'", r"'lens\.model': .*'equidistant'"),
        ("width = 0", r"'lens\.width'"),
    ],
)
def test_a_wrong_rig_is_named(sim, line, says):
    key = line.split()[0]
    text = builtin_file("rig", "egorig1").read_text().splitlines()
    Path("rig.toml").write_text("\n".join(line if t.startswith(f"{key} ") else t for t in text))
    Path("good.toml").write_text(GOOD)
    found = complaint(sim("generate", "good.toml", "--rig", "rig.toml", "--out", "seq"))
    assert re.search(rf"rig\.toml, key {says}", found), found
    assert not Path("seq").exists()


def test_output_folders_that_cannot_be(sim, tiny_scene, tiny_sequence):
    Path("tiny.toml").write_text(to_toml(tiny_scene))
    before = sorted((p.name, p.stat().st_mtime_ns) for p in tiny_sequence.iterdir())
    line = complaint(sim("generate", "tiny.toml", "--seed", 5, "--out", tiny_sequence))
    assert "holds another sequence (it differs in seed: 162 recorded, 5 requested)" in line
    assert sorted((p.name, p.stat().st_mtime_ns) for p in tiny_sequence.iterdir()) == before
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("dear to me")
    line = complaint(sim("generate", "tiny.toml", "--out", "mine"))
    assert "mine holds other files ('notes.txt')" in line
    for out in ("tiny.toml", "tiny.toml/below"):
        assert "is not a folder" in complaint(sim("generate", "tiny.toml", "--out", out))
    line = complaint(sim("generate", "tiny.toml", "tiny.toml", "--out", "both"))
    assert "two scenes have the name 'validation-walk'" in line


def test_a_newer_or_mangled_sequence_is_refused_by_every_command(sim, tiny_scene, tiny_sequence):
    Path("tiny.toml").write_text(to_toml(tiny_scene))
    Path("seq").mkdir()
    text = (tiny_sequence / "manifest.json").read_text()
    newer = text.replace(f'"schema_version":{SCHEMA}', '"schema_version":99')
    commands = [("generate", "tiny.toml", "--out", "seq"), ("verify", "seq"),
                ("preview", "seq", "--out", "a.png")]  # fmt: skip
    for content, says in (
        (newer, "newer version (schema 99)"),
        (text[: len(text) // 2], "manifest.json, line 1: not JSON"),
    ):
        Path("seq/manifest.json").write_text(content)
        for words in commands:
            assert says in complaint(sim(*words))


def test_without_opengl_the_machine_is_blamed(tmp_path):
    """In a process of its own: OpenGL is looked for once."""
    (tmp_path / "good.toml").write_text(GOOD)
    nothing = os.environ | {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
    done = subprocess.run(
        [sys.executable, "-m", "egocap_sim", "generate", str(tmp_path / "good.toml"),
         "--out", str(tmp_path / "seq")],
        env=nothing, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, ""), done.stderr
    assert "Traceback" not in done.stderr and "apt-get install libegl1" in done.stderr
    assert not (tmp_path / "seq").exists()


def test_list_names_what_there_is(sim):
    code, out, err = sim("list")
    assert (code, err) == (0, "")
    assert "validation-walk" in out and "egorig2" in out and "look_around" in out


@pytest.mark.parametrize("words", [(), ("genrate",), ("generate",), ("verify",), ("list", "--x")])
def test_wrong_usage_is_2(sim, words):
    code, out, err = sim(*words)
    assert (code, out) == (2, "") and err and "Traceback" not in err


def test_a_motion_file_decides_how_long_a_sequence_is(monkeypatch):
    """As long as the clip, unless frames are asked for; more than it has is refused."""
    import numpy as np

    from egocap_sim.core.resources import builtin_file
    from egocap_sim.motion.clips.clip_check import ClipReport
    from egocap_sim.motion.clips.load import LoadedMotion
    from egocap_sim.motion.kinematics.clip import Clip
    from egocap_sim.scene.config import load_scene

    clip = Clip("two seconds", 60.0, np.zeros((121, 21, 3)), np.tile(np.eye(3), (121, 21, 1, 1)))
    report = ClipReport(clip.name, 121, 60.0, (), 0.0, 0.0)
    motion = LoadedMotion(clip, clip, report)
    monkeypatch.setattr("egocap_sim.motion.clips.load.load_motion", lambda *a, **options: motion)
    scene = load_scene(builtin_file("scene", "validation-gesture"))
    for asked, frames in (
        (Overrides(motion="clip.bvh"), 60),
        (Overrides(motion="clip.bvh", start=1.0), 30),
        (Overrides(motion="clip.bvh", frames=10), 10),
        (Overrides(), 750),
    ):
        assert override_scene(scene, asked).frames == frames


def _write_motion(path, local):
    from egocap.geometry import matrix_to_quaternion
    from egocap_sim.core.bodies import BODIES
    from egocap_sim.motion.clips.cleaning import with_local_rotations
    from egocap_sim.motion.generators.registry import make_motion

    clip = make_motion("explain", 2.0, np.random.default_rng(1))
    clip = with_local_rotations(clip, local(clip))
    quaternions = matrix_to_quaternion(clip.rotations)
    np.savez(path, joints=np.array(BODIES), pos=clip.positions, quat=quaternions, fps=clip.fps)


def _elbow_reversed(clip):
    from egocap.geometry import axis_angle
    from egocap_sim.core.bodies import INDEX
    from egocap_sim.motion.clips.cleaning import to_local

    local = to_local(clip.rotations)
    local[:, INDEX["l_forearm"]] = axis_angle(np.array([0.0, 1.0, 0.0]), np.deg2rad(100))
    return local


def test_suspect_motion_is_listed_drawn_and_refused_by_strict(sim, monkeypatch, tiny_scene, caplog):
    from egocap_sim.motion.clips.cleaning import to_local

    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    Path("clips").mkdir()
    _write_motion("clips/good.npz", lambda clip: to_local(clip.rotations))
    _write_motion("clips/reversed.npz", _elbow_reversed)
    Path("clips/broken.bvh").write_text("nothing")
    code, out, _ = sim("check-motion", "clips", "--out", "clips.html", "--json")
    found = {Path(row["file"]).name: row for row in json.loads(out)}
    verdicts = {name: row["verdict"] for name, row in found.items()}
    assert (code, verdicts) == (0, {"good.npz": "good", "reversed.npz": "suspect",
                                    "broken.bvh": "unreadable"})  # fmt: skip
    assert found["reversed.npz"]["findings"][0]["where"] == "left_elbow"
    page = Path("clips.html").read_text()
    assert page.count("<svg") == 2 and "left elbow bends backwards" in page
    code, out, _ = sim("check-motion", "clips", "--strict")
    assert code == 3 and "! left elbow bends backwards" in out
    assert sim("check-motion", "clips/good.npz", "--strict")[0] == 0
    assert "nowhere: no such file" in sim("check-motion", "nowhere")[2]
    Path("tiny.toml").write_text(to_toml(tiny_scene))
    made = "generate", "tiny.toml", "--frames", 2, "--motion", "clips/reversed.npz", "--out", "seq"
    assert "suspect: left elbow bends backwards" in complaint(sim(*made, "--strict"))
    code, out, _ = sim(*made, "--workers", 1, "--json")
    assert code == 0 and "left elbow bends backwards" in caplog.text
    summary = json.loads(out)
    assert summary["motions"][0]["verdict"] == "suspect"
    assert summary["physics"]["raw_error_max_cm"] > 20 > 5 > summary["physics"]["joint_error_cm"]


def test_refine_follows_a_track_and_says_what_changed(sim):
    from egocap.data.track import load_track, save_track

    track = track_of(*standing(20))
    save_track("track.npz", track)
    words = "refine", "track.npz", "--out", "refined.npz"
    code, out, _ = sim(*words, "--mass", 70, "--forces", "forces.npz")
    assert code == 0 and "20 of 20 frames followed by a body of 70.0 kg" in out
    assert "weight borne by: feet 9" in out and Path("forces.npz").exists()
    assert load_track("refined.npz").config["refined"]["mass_kg"] == 70.0
    assert json.loads(sim(*words, "--json")[1])["refined"] == 20
    assert "0.01 to 100" in complaint(sim(*words, "--residual", 0))
    assert "mass of 3 kg" in complaint(sim(*words, "--mass", 3))
    save_track("head.npz", replace(track, contacts=None, T_world_head=None, joints_world=None))
    assert "made with --head-pose" in complaint(sim("refine", "head.npz", "--out", "x.npz"))
    assert not Path("x.npz").exists()
