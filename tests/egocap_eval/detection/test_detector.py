"""The detector's study: what it counts, in which pixels, and what it calls missed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.body.labels import LABELS
from egocap.data.detections import Detections, save_detections
from egocap.data.sequence import Sequence
from egocap.data.truth import VISIBLE
from egocap.detect.canonical_view import CanonicalView
from egocap.errors import FileError, InputError
from egocap_eval.detection.detector import CURVE, GROUPS, missed, score, study, summary, tables
from egocap_eval.detection.detector_plots import draw
from egocap_eval.detection.validation_frames import PARTS, make_validation, validation_scenes
from egocap_sim.world.world import World


def exact(sequence, off=0.0):
    """Detections at the truth of every joint in view, `off` pixels of a 640 wide image to one side,
    with a sigma that says so."""
    truth, width = sequence.truth, sequence.rig.cameras[0].width
    points = truth.joints_2d + [off * width / 640, 0.0]
    seen = truth.visibility == VISIBLE
    return Detections(
        truth.time, np.where(truth.in_view[..., None], points, np.nan),
        np.full(truth.in_view.shape, max(off, 1e-6) * width / 640 / np.sqrt(2)),
        np.where(seen, 0.9, 0.1), truth.in_view, "test",
    )  # fmt: skip


@pytest.fixture(scope="module")
def sequence(tiny_sequence):
    return Sequence(tiny_sequence)


def test_exact_detections_score_all(sequence):
    result = summary({"tiny": score(sequence, exact(sequence))})
    for kind in ("visible", "in_view"):
        assert result[kind]["pck20"] == result[kind]["auc20"] == 100.0
        assert result[kind]["curve"]["0"] == 100.0
    assert result["false_positives"] in (0.0, None)  # None: every joint is in view
    assert result["visible"]["joints"] == int((sequence.truth.visibility == VISIBLE).sum())
    assert result["frames"] == 7


def test_errors_are_in_pixels_of_640_and_sigma_with_them(sequence):
    scored = score(sequence, exact(sequence, off=5.0))
    assert scored.errors[scored.in_view] == pytest.approx(5.0)
    result = summary({"tiny": scored})
    assert result["visible"]["auc20"] == pytest.approx(75.0)
    assert result["visible"]["curve"]["4"] == 0.0 and result["visible"]["curve"]["6"] == 100.0
    spread = result["spread"]["visible"]
    assert spread["normalised_error"] == pytest.approx(1.0)
    shown = [value for value in spread["groups"].values() if value is not None]
    assert shown and shown == pytest.approx([1.0] * len(shown))
    assert result["confidence"]["occlusion_auroc"] == 1.0
    hits = result["visible"]["group_curves"]["knee"]
    assert hits is not None and len(hits) == len(CURVE)


def test_groups_hold_every_label_once():
    named = [n for n in LABELS for parts in GROUPS.values() if n.split("_")[-1] in parts]
    assert sorted(named) == sorted(LABELS)


def test_missing_and_invented_joints(sequence):
    truth, found = sequence.truth, exact(sequence)
    elbow = LABELS.index("left_elbow")
    valid = found.valid.copy()
    valid[:, :, elbow] = False
    none = summary({"tiny": score(sequence, replace(found, valid=valid))})
    assert none["in_view"]["per_joint"]["left_elbow"] == 0.0
    assert none["in_view"]["groups"]["elbow"] < 100.0
    everywhere = np.ones_like(found.valid)
    points = np.where(found.valid[..., None], found.points, 3.0)
    made_up = replace(found, valid=everywhere, points=points)
    invented = summary({"tiny": score(sequence, made_up)})
    assert invented["false_positives"] == (1.0 if (~truth.in_view).any() else None)


def test_the_first_frames_are_enough_but_other_frames_are_refused(sequence):
    found = exact(sequence)
    rows = {n: getattr(found, n)[:3] for n in ("times", "points", "sigma", "confidence", "valid")}
    assert summary({"t": score(sequence, replace(found, **rows))})["frames"] == 3
    with pytest.raises(InputError, match="different times"):
        score(sequence, replace(found, times=found.times + 0.5))
    one_eyed = {n: getattr(found, n)[:, :1] for n in ("points", "sigma", "confidence", "valid")}
    with pytest.raises(InputError, match="1 views"):
        score(sequence, replace(found, **one_eyed))


def test_study_of_a_file(sequence, tmp_path):
    save_detections(tmp_path / "d.npz", exact(sequence, off=5.0))
    outcome = study((sequence.folder,), detections=tmp_path / "d.npz", picture=tmp_path / "p.png")
    assert outcome.missed == [m for m in outcome.missed if "auc20" in m] and outcome.missed
    assert outcome.config["sequences"] == {sequence.manifest.name: sequence.manifest.config_sha256}
    assert "89.5" in outcome.to_text() and (tmp_path / "p.png").stat().st_size > 10000
    with pytest.raises(InputError, match="one"):
        study((sequence.folder, sequence.folder), detections=tmp_path / "d.npz")
    with pytest.raises(InputError, match="validation"):
        study(())


def test_what_is_missed_is_said(sequence):
    scored = score(sequence, exact(sequence, off=25.0))
    result = summary({"t": replace(scored, sigma=scored.sigma / 3)})
    result["speed"] = {"pairs_per_second": 12.0, "engine": "x", "threads": 2, "stage_cpu_ms": {}}
    said = "; ".join(missed(result))
    for words in ("pck20", "wrist", "normalised error of visible joints is 3.00", "12 pairs/s"):
        assert words in said
    assert any("1.25" not in cell for t in tables(result) for row in t.rows for cell in row)


def test_drawing_takes_what_could_not_be_measured(sequence, tmp_path):
    scored = score(sequence, exact(sequence))
    blind = replace(scored, seen=np.zeros_like(scored.seen))
    draw(summary({"t": blind}), tmp_path / "p.png")
    assert (tmp_path / "p.png").is_file()


def test_validation_footage_is_of_validation_seeds(tmp_path):
    assert sum(p.frames for p in PARTS.values()) == 1000
    scenes = validation_scenes()
    assert sum(s.frames for s in scenes) == 750
    assert all(160 <= s.seed <= 170 and s.rig.size == (640, 512) for s in scenes)
    assert {s.rig.name for s in validation_scenes(rig="egorig2")} == {"egorig2"}
    with pytest.raises(FileError, match="no such clip"):
        make_validation(tmp_path / "out", motions=tmp_path)


def test_validation_footage_of_a_rig_file_keeps_its_aspect(tmp_path):
    path = tmp_path / "square.toml"
    path.write_text(
        """name = "square"
[lens]
model = "equidistant"
width = 872
height = 872
fov = 190.0
[stereo]
baseline = 0.2
forward = 0.2
up = 0.1
pitch = 70.0
"""
    )
    scenes = validation_scenes(rig=str(path))
    assert {s.rig.size for s in scenes} == {(640, 640)}
    assert {s.rig.file for s in scenes} == {str(path)} and {s.rig.name for s in scenes} == {None}
    with pytest.raises(FileError, match=r"none\.toml"):
        validation_scenes(rig="none.toml")


@pytest.mark.parametrize("name", ["ocam", "wide", "narrow"])
def test_rigs_that_no_training_has_seen_can_be_rendered(name):
    path = Path(__file__).parents[3] / "evals/rigs" / f"{name}.toml"
    scene = validation_scenes(rig=str(path))[0]
    rig = World(scene).rig
    assert rig.name == name and rig.cameras[0].width == 640
    assert all(CanonicalView(mount).mask.mean() > 0.4 for mount in rig.mounts)
