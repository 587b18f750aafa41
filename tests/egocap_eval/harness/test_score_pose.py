"""egocap-eval pose, from files on disk to the printed numbers."""

import json
import re
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.body.proportions import Proportions
from egocap.cameras.rig_files import load_rig
from egocap.data.detections import Detections, save_detections
from egocap.data.manifest import SCHEMA, Manifest
from egocap.data.sequence import open_sequence
from egocap.data.sequence_writer import SequenceWriter, write_shard
from egocap.data.track import Track, save_track
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE, Truth
from egocap.detect.sources import detections_from
from egocap.errors import InputError
from egocap.evaluation.predictions import Predictions, save_predictions
from egocap.evaluation.scoring import evaluate, with_detections
from egocap.track.tracker import Tracker
from egocap_eval.cli import main
from egocap_eval.harness.score_pose import run_tracker

FRAMES = 130
KEYS = [
    "mpjpe_mm", "pa_mpjpe_mm", "upper_mm", "lower_mm", "median_mm", "p95_mm", "accel_error",
    "pck20", "auc20", "per_joint_mm", "visible_share", "frames", "protocol",
]  # fmt: skip


def make_rig():
    return load_rig(Path(__file__).parents[3] / "scenes/rigs/egorig1.toml").resized(1280, 1024)


def make_truth():
    rig, times = make_rig(), np.arange(FRAMES) / 30
    sway = 0.05 * np.sin(2 * times[:, None, None] + np.arange(54).reshape(18, 3))
    joints = Proportions.from_lengths(1.75).rest_joints + sway
    pixels, valid = rig.project(joints)
    pixels, valid = np.moveaxis(pixels, 0, 1), np.moveaxis(valid, 0, 1)
    size = np.array([[c.width, c.height] for c in rig.cameras])[:, None]
    in_view = valid & (pixels > -0.5).all(-1) & (pixels < size - 0.5).all(-1)
    visibility = np.where(in_view, VISIBLE, OUT_OF_VIEW).astype(np.uint8)
    for view, (cause, joints_hidden) in enumerate(
        ((SELF_OCCLUDED, [4, 13, 16]), (OCCLUDED, [5, 14, 16]))
    ):
        hidden = in_view[:, view] & np.isin(np.arange(18), joints_hidden)
        visibility[:, view][hidden] = cause
    eye = np.broadcast_to(np.eye(4), (FRAMES, 21, 4, 4))
    return Truth(
        time=times,
        T_world_head=eye[:, 0],
        joints_world=joints,
        joints_head=joints,
        joints_camera=np.stack([joints, joints], 1),
        joints_2d=np.where(in_view[..., None], pixels, np.nan),
        in_view=in_view,
        visibility=visibility,
        T_world_body=eye,
        contact=np.ones((FRAMES, 4), bool),
        ground_force=np.zeros((FRAMES, 2, 3)),
        root_wrench=np.zeros((FRAMES, 6)),
    )


def make_track(truth, joints=None, **changes):
    frames = len(truth.time)
    track = Track(
        times=truth.time,
        angles=np.zeros((frames, 37)),
        joints_head=truth.joints_head if joints is None else joints,
        energy=np.zeros(frames),
        converged=np.arange(frames) % 2 == 0,
        detections_used=np.full(frames, 30.0),
        seconds_per_frame=0.004,
        config={"detections": "simulated:2.0"},
    )
    return replace(track, **changes)


def make_detections(truth, shift=0.0, **changes):
    valid = truth.visibility == VISIBLE
    found = Detections(
        times=truth.time,
        points=np.where(valid[..., None], truth.joints_2d + [shift, 0.0], 0.0),
        sigma=np.ones(valid.shape),
        confidence=np.ones(valid.shape),
        valid=valid,
        source="simulated:2.0",
    )
    return replace(found, **changes)


def make_predictions(truth, positions=None, rows=None, **changes):
    rows = np.arange(FRAMES) if rows is None else rows
    positions = truth.joints_head if positions is None else positions
    given = Predictions(positions[rows], np.ones((len(rows), 18), bool), "head", "m", rows)
    return replace(given, **changes)


@pytest.fixture(scope="module")
def truth():
    return make_truth()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, truth):
    folder = tmp_path_factory.mktemp("eval") / "walk"
    manifest = Manifest(
        schema_version=SCHEMA, name="tiny", fps=30.0, frames=FRAMES, shard_frames=FRAMES,
        views=("left", "right"), seed=3, config={}, config_sha256="0" * 64, code_version="1",
    )  # fmt: skip
    body = Proportions.from_lengths(1.75).to_dict()
    side = {"rig.json": make_rig().to_dict(), "body.json": body}
    side = {name: json.dumps(content).encode() for name, content in side.items()}
    with SequenceWriter(folder, manifest, side) as writer:
        writer.begin()
        writer.add_shard(write_shard(folder, 0, 0, [{"json": b"{}"}] * FRAMES))
        truth.save(folder.parent / "truth.npz")
        writer.write_file("truth.npz", (folder.parent / "truth.npz").read_bytes())
    return folder


@pytest.fixture
def files(folder, truth, tmp_path):
    joints = truth.joints_head + [0.0, 0.03, 0.0]
    save_track(tmp_path / "track.npz", make_track(truth, joints))
    save_detections(tmp_path / "detections.npz", make_detections(truth, 8.0))
    return [str(folder), "--track", str(tmp_path / "track.npz")]


def test_a_perfect_track_and_perfect_detections(folder, truth):
    sequence = open_sequence(folder)
    report = evaluate(make_track(truth), sequence)
    assert report.mpjpe_mm == 0 and report.accel_error == 0
    assert report.reprojection.pck20 == 100
    assert report.reprojection.auc20 == pytest.approx(100)
    assert report.pck20 is None and report.auc20 is None and report.detections is None
    assert report.tracker_fps == pytest.approx(250) and report.converged_share == 0.5
    everywhere = make_detections(truth, valid=truth.in_view, points=truth.joints_2d)
    report = with_detections(report, sequence, everywhere)
    assert report.pck20 == report.auc20 == 100


def test_hidden_joints_without_detection_are_misses(folder, truth):
    sequence = open_sequence(folder)
    report = with_detections(evaluate(make_track(truth), sequence), sequence,
                             make_detections(truth, shift=8.0))  # fmt: skip
    hidden = (truth.in_view & (truth.visibility != VISIBLE)).sum() / truth.in_view.sum()
    assert 0 < hidden < 0.5
    assert report.pck20 == pytest.approx(100 * (1 - hidden))
    assert report.auc20 == pytest.approx(100 * (1 - hidden) * (1 - 4 / 20))
    assert report.detections.pck20_seen == 100
    assert report.detections.missing_share == pytest.approx(hidden)


def test_visible_share_is_of_joints_seen_by_either_camera(folder, truth):
    report = evaluate(make_track(truth), open_sequence(folder))
    seen = (truth.visibility == VISIBLE).any(1)[:, 1:]
    assert report.visible_share == pytest.approx(seen.mean()) == 16 / 17


def test_a_joint_tracked_out_of_the_lens_is_a_miss(folder, truth):
    joints = truth.joints_head.copy()
    joints[:, LABELS.index("left_hand")] = [0.0, 0.0, 3.0]  # far above cameras that look down
    report = evaluate(make_track(truth, joints), open_sequence(folder))
    score = report.reprojection
    assert score.per_joint_pck20["left_hand"] == 0
    assert score.per_joint_pck20["right_hand"] == 100
    assert score.missing_share > 0


def test_a_track_of_other_frames_is_refused(folder, truth):
    sequence = open_sequence(folder)
    with pytest.raises(InputError, match="frame 0"):
        evaluate(make_track(truth, times=truth.time + 0.5), sequence)
    later = truth.time + 0.01 * (np.arange(FRAMES) == 4)
    with pytest.raises(InputError, match="frame 4"):
        evaluate(make_track(truth, times=later), sequence)
    with pytest.raises(InputError, match=f"{FRAMES - 1} frames"):
        evaluate(make_track(truth, times=truth.time[:-1]), sequence)
    with pytest.raises(InputError, match=r"detections file .* frame 0"):
        late = make_detections(truth, times=truth.time + 0.5)
        with_detections(evaluate(make_track(truth), sequence), sequence, late)


def test_joints_alone_are_scored_too(folder, truth):
    sequence = open_sequence(folder)
    joints = truth.joints_head + [0.0, 0.03, 0.0]
    joints[3, LABELS.index("neck")] = np.nan
    report = evaluate(joints, sequence, detections=make_detections(truth))
    assert report.mpjpe_mm == pytest.approx(30) and report.detections is not None
    assert report.coverage_share == pytest.approx(1 - 1 / (17 * FRAMES))
    with pytest.raises(InputError, match=r"\(T, 18, 3\)"):
        evaluate(joints[:, :17], sequence)
    with pytest.raises(InputError, match="1 of"):
        evaluate(joints[:-1], sequence)


@pytest.mark.parametrize("missing", [0.02, 0.5, 0.95])
def test_your_tracker_is_scored_whatever_joints_are_missing(folder, truth, missing, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples"))
    rng = np.random.default_rng(0)
    found = make_detections(truth, 1.0)
    valid = found.valid & (rng.random(found.valid.shape) >= missing)
    valid[:5] = False
    found = replace(found, valid=valid, points=np.where(valid[..., None], found.points, np.nan))
    sequence = open_sequence(folder)
    result = run_tracker("your_tracker:track", sequence, found)
    report = evaluate(result, sequence, detections=found)
    both = valid.all(1)[:, 1:]
    assert report.coverage_share == pytest.approx(both.mean())
    assert report.mpjpe_mm < 60
    if np.isin(both.sum(1), (1, 2)).any():  # a frame of too few joints to align
        assert report.pa_mpjpe_mm is None
    else:
        assert report.pa_mpjpe_mm is not None and report.pa_mpjpe_mm < 60
    assert not [name for name in report.other_protocols_mm if "-ba" in name]


def test_predictions_without_a_head_are_scored_in_the_world(folder, truth):
    """The joints of a protocol are enough for its measures in the world."""
    valid = np.ones((FRAMES, 18), bool)
    valid[:, LABELS.index("head")] = False
    valid[3, LABELS.index("neck")] = False
    positions = np.where(valid[..., None], truth.joints_world + [0.0, 0.0, 0.02], 0.0)
    given = make_predictions(truth, positions, valid=valid, frame="world")
    report = evaluate(given, open_sequence(folder))
    assert report.frames_in_world == FRAMES - 1
    for name in ("world_mpjpe_mm", "world_aligned_mpjpe_mm", "penetration_mm"):
        assert getattr(report, name) == pytest.approx(0, abs=1e-6), name
    assert evaluate(given, open_sequence(folder), protocol="egocap-18").frames_in_world == 0


def test_a_score_names_the_body_of_its_track(folder, truth):
    sequence = open_sequence(folder)
    other = 1.05 * sequence.body.offsets
    for expected, offsets, config in (
        ("not stated", None, {}),
        ("true", sequence.body.offsets, {"body": "body.json"}),
        ("fitted", other, {"body": "fit"}),
        ("fitted 1.8", other, {"body": "fit:1.8"}),
        ("average 1.8", other, {"body": "average:1.8"}),
        ("mine.json", other, {"body": "mine.json"}),
        ("not the true one", other, {}),
    ):
        report = evaluate(make_track(truth, offsets=offsets, config=config), sequence)
        assert report.body == expected
        assert f"{FRAMES} frames" in report.heading() and f"body {expected}" in report.heading()


def test_command_prints_json_to_stdout(files, capsys):
    assert main(["pose", *files, "--json"]) == 0
    captured = capsys.readouterr()
    data = json.loads(captured.out)
    assert captured.err == ""
    assert set(KEYS) <= data.keys()
    assert data["mpjpe_mm"] == pytest.approx(30)
    assert data["pa_mpjpe_mm"] == pytest.approx(0, abs=1e-6)
    assert data["pck20"] is None and data["reprojection"]["pck20"] is not None
    assert data["frames"] == FRAMES and data["protocol"] == "egocap-17"
    assert list(data["per_joint_mm"]) == list(LABELS[1:])
    assert data["detections_source"] == "simulated:2.0"
    assert data["provenance"]["seed"] == 3


def test_command_prints_tables(files, capsys, tmp_path):
    words = ["pose", *files, "--detections", str(tmp_path / "detections.npz")]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "130 frames; detections simulated:2.0" in text.splitlines()[0]
    assert "MPJPE                30.0  mm" in text and "simulated:2.0" in text
    assert main([*words, "--markdown", "--protocol", "egocap-17-pa"]) == 0
    assert "egocap-17-pa: " in capsys.readouterr().out


@pytest.mark.parametrize("suffix", ["json", "md", "txt"])
def test_command_writes_the_report(files, capsys, tmp_path, suffix):
    out = tmp_path / "new" / f"report.{suffix}"
    assert main(["pose", *files, "--out", str(out)]) == 0
    assert "MPJPE" in capsys.readouterr().out
    text = out.read_text()
    assert "egocap-17" in text
    if suffix == "json":
        record = json.loads(text)
        assert record["command"].startswith(f"egocap-eval pose {files[0]} --track {files[2]}")
        assert record["result"]["mpjpe_mm"] == pytest.approx(30)


def spoiled(truth, frame, joint):
    joints = truth.joints_head.copy()
    joints[frame, LABELS.index(joint)] = np.nan
    return joints


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("/nowhere --track good.npz", "/nowhere"),
        ("SEQ --track no.npz", "no.npz"),
        ("SEQ --track detections.npz", "detections.npz"),
        ("SEQ --track short.npz", "short.npz: .*9 frames.*130"),
        ("SEQ --track nan.npz", "nan.npz.* finite"),
        ("SEQ --track track.npz --detections track.npz", "track.npz"),
        ("SEQ --track track.npz --protocol h36m", "egocap-17-pa"),
        ("SEQ", "exactly one of --track, --predictions, --tracker"),
        ("SEQ --track track.npz --predictions mine.npz", "exactly one of --track, --predictions"),
        ("SEQ --predictions mm.npz", "mm.npz: .*stated unit is 'm' .*unit 'mm'"),
        ("SEQ --predictions gap.npz", "gap.npz: 3 of 130 frames are missing: 5-7"),
        ("SEQ --predictions track.npz", "track.npz.*unknown key"),
        ("SEQ --tracker nobody", "no plug-in 'nobody'.*MODULE:FUNCTION"),
        ("SEQ --tracker no_module:track", "no_module"),
        ("SEQ --tracker egocap", "needs --detections"),
        ("SEQ --tracker egocap --track track.npz", "exactly one of --track"),
        ("SEQ --track track.npz --json --markdown", "one of them"),
        ("SEQ --track track.npz --out report.pdf", ".json, .md, .txt"),
    ],
)
def test_bad_input_is_one_line_and_2(
    words, message, files, folder, truth, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    short = replace(truth, time=truth.time[:9], joints_head=truth.joints_head[:9])
    save_track("short.npz", make_track(short))
    save_track("nan.npz", make_track(truth, spoiled(truth, 7, "left_knee")))
    save_predictions("mm.npz", make_predictions(truth, positions=1000 * truth.joints_head))
    keep = np.r_[0:5, 8:FRAMES]
    save_predictions("gap.npz", make_predictions(truth, rows=keep))
    before = sorted(tmp_path.iterdir())
    assert main(["pose", *words.replace("SEQ", str(folder)).split()]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert re.search(message, captured.err), captured.err
    assert sorted(tmp_path.iterdir()) == before


def test_a_score_with_nan_names_frame_and_joint(folder, truth):
    with pytest.raises(InputError, match="frame 7, left_knee"):
        evaluate(make_track(truth, spoiled(truth, 7, "left_knee")), open_sequence(folder))


def test_predictions_score_as_the_same_track_does(files, folder, truth, tmp_path, capsys):
    assert main(["pose", *files, "--json"]) == 0
    of_track = json.loads(capsys.readouterr().out)
    world = truth.joints_head + [0.0, 0.03, 0.0]  # the head stands at the world's origin here
    save_predictions(tmp_path / "mine.jsonl", make_predictions(truth, world, frame="world"))
    words = ["pose", str(folder), "--predictions", str(tmp_path / "mine.jsonl"), "--json"]
    assert main(words) == 0
    report = json.loads(capsys.readouterr().out)
    for name in ("mpjpe_mm", "pa_mpjpe_mm", "accel_error", "mpjpe_ci95_mm", "foot_skate"):
        assert report[name] == pytest.approx(of_track[name], abs=1e-6), name
    assert report["warnings"] == [] and report["coverage_share"] == 1


def test_missing_frames_are_skipped_when_asked_and_said(folder, truth, tmp_path, capsys):
    rows = np.arange(0, FRAMES, 2)
    save_predictions(tmp_path / "half.npz", make_predictions(truth, rows=rows, method="half"))
    words = ["pose", str(folder), "--predictions", str(tmp_path / "half.npz")]
    assert main(words) == 2
    capsys.readouterr()
    assert main([*words, "--missing", "skip"]) == 0
    text = capsys.readouterr().out
    assert "130 frames; half" in text and re.search(r"joints predicted +50.0", text)


def test_our_own_tracker_is_given_the_pictures_as_in_egocap_track(tiny_sequence, capsys):
    words = ["--tracker", "egocap", "--detections", "simulated:2", "--json"]
    assert main(["pose", str(tiny_sequence), *words]) == 0
    sequence = open_sequence(tiny_sequence)
    found = detections_from(sequence, "simulated:2", 0)
    tracked = Tracker(sequence.rig, sequence.body).track(found, sequence.images)
    expected = evaluate(tracked, sequence).mpjpe_mm
    assert json.loads(capsys.readouterr().out)["mpjpe_mm"] == pytest.approx(expected)


def test_the_example_tracker_is_run_and_scored(folder, truth, tmp_path, capsys, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples"))
    save_detections(tmp_path / "exact.npz", make_detections(truth))
    words = ["pose", str(folder), "--tracker", "your_tracker:track", "--json"]
    assert main([*words, "--detections", str(tmp_path / "exact.npz")]) == 0
    report = json.loads(capsys.readouterr().out)
    both = (truth.visibility == VISIBLE).all(1)[:, 1:]
    assert report["coverage_share"] == pytest.approx(both.mean()) and both.mean() > 0.5
    assert report["mpjpe_mm"] < 0.01  # exact detections meet in the true joints
    assert report["method"] == "your_tracker:track" and report["detections_source"]

    import your_tracker

    out = tmp_path / "mine.jsonl"
    your_tracker.main(str(folder), str(out))
    assert "joints predicted" in capsys.readouterr().out
    assert main(["pose", str(folder), "--predictions", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["method"] == "triangulation" and 0.1 < report["mpjpe_mm"] < 50


def test_a_tracker_that_hands_back_something_else(folder, monkeypatch):
    module = types.ModuleType("odd_tracker")
    module.track = lambda footage, detections: np.zeros((3, 18, 3))
    monkeypatch.setitem(sys.modules, "odd_tracker", module)
    with pytest.raises(InputError, match=r"\(3, 18, 3\).*\(130, 18, 3\)"):
        run_tracker("odd_tracker:track", open_sequence(folder), None)


def test_a_detector_plugs_in_and_meets_no_truth(folder, truth, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "examples"))
    module, given = types.ModuleType("odd_detector"), []

    def detect(footage):
        given.append(footage)
        return make_detections(truth, source="mine")

    module.detect, module.nothing = detect, lambda footage: None
    monkeypatch.setitem(sys.modules, "odd_detector", module)
    words = ["pose", str(folder), "--tracker", "your_tracker:track", "--detections"]
    assert main([*words, "detector:odd_detector:detect", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["detections"]["source"] == "mine" and report["detections"]["pck20_seen"] == 100
    (footage,) = given
    assert len(footage) == FRAMES and footage.rig == make_rig()
    assert not any("truth" in name for name in vars(footage))
    assert main([*words, "detector:odd_detector:nothing"]) == 2
    assert "returned a NoneType" in capsys.readouterr().err
