"""Clips that no person can perform are found, repaired or left, and listed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from egocap.geometry import axis_angle
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.clips.anatomy import joint_angles
from egocap_sim.motion.clips.cleaning import to_local, with_local_rotations
from egocap_sim.motion.clips.clip_check import ClipReport
from egocap_sim.motion.clips.load import LoadedMotion, clean, load_motion
from egocap_sim.motion.kinematics.clip import Clip

FORWARD = {"forearm": -1.0, "calf": 1.0}  # sense of flexion about the left axis
HEAD_DOWN = (0.0, 1.0, 0.0)


def loaded(clip: Clip, local: np.ndarray) -> LoadedMotion:
    """The clip with other rotations to the parents, loaded like a file of unknown bone frames."""
    return clean(dataclasses.replace(with_local_rotations(clip, local), canonical=False))


def bent(clip: Clip, body: str, degrees: float) -> np.ndarray:
    """Local rotations with one limb bent by an angle that varies by a tenth."""
    local = to_local(clip.rotations)
    angle = np.deg2rad(degrees * (1.0 + 0.1 * np.sin(0.1 * np.arange(len(local)))))
    part = body.partition("_")[2]
    local[:, INDEX[body]] = axis_angle(np.array([0.0, FORWARD[part], 0.0]), angle)
    return local


@pytest.mark.parametrize("body,hinge", [("l_forearm", "left_elbow"), ("r_calf", "right_knee")])
def test_reversed_hinge_is_found_and_bent_the_other_way(active, body, hinge):
    wanted = loaded(active, bent(active, body, 100))
    found = loaded(active, bent(active, body, -100))
    assert not any(f.kind == "reversed" for f in wanted.report.findings)
    (finding,) = [f for f in found.report.findings if f.kind == "reversed"]
    assert finding.where == hinge and finding.severe and found.report.verdict == "suspect"
    end = INDEX[body[:2] + ("hand" if "forearm" in body else "foot")]
    difference = found.clip.positions[:, end] - wanted.clip.positions[:, end]
    assert np.linalg.norm(difference, axis=1).mean() < 0.03
    raw = found.raw.positions[:, end] - wanted.clip.positions[:, end]
    assert np.linalg.norm(raw, axis=1).mean() > 0.2  # stays as recorded
    assert found.report.moved_max_cm > 30


def test_tilted_head_is_raised(active):
    local = to_local(active.rotations)
    tilted = slice(150, 270)
    tilt = axis_angle(np.array(HEAD_DOWN), np.deg2rad(99))
    local[tilted, INDEX["head"]] = tilt @ local[tilted, INDEX["head"]]
    found = loaded(active, local)
    (finding,) = [f for f in found.report.findings if f.where == "neck_flexion"]
    assert finding.severe and finding.change and finding.worst == pytest.approx(39, abs=15)
    flexion = np.rad2deg(np.abs(joint_angles(found.clip)["neck_flexion"]))
    assert flexion.max() < 60


def test_neck_off_the_trunk_is_found(active):
    local = to_local(active.rotations)
    local[:, INDEX["neck"]] = axis_angle(np.array([1.0, 0, 0]), np.deg2rad(99)) @ local[
        :, INDEX["neck"]
    ]  # fmt: skip
    assert [f.kind for f in loaded(active, local).report.findings if f.severe] == ["neck"]


def test_floor_and_cuts_are_listed(active):
    positions = active.positions + [0.0, 0.0, 0.4]
    positions[:6] += 3.0
    report = clean(dataclasses.replace(active, positions=positions)).report
    kinds = {f.kind: f for f in report.findings}
    assert kinds["cut"].share == pytest.approx(6 / len(positions))
    assert kinds["floor"].worst == pytest.approx(0.4, abs=0.02)
    assert report.verdict == "repaired"


def test_sinking_feet_are_found(active):
    positions = active.positions.copy()
    lowest = np.arange(len(positions)) % 30 == 0  # rarer than the floor's quantile
    positions[lowest, :, 2] -= 0.15
    report = clean(dataclasses.replace(active, positions=positions)).report
    assert [f.worst for f in report.findings if f.kind == "sunk"] == [pytest.approx(0.15, abs=0.02)]


def test_plausible_clip_has_no_findings(active):
    report = clean(active).report
    assert report.verdict == "good" and report.moved_cm == 0
    assert ClipReport.from_dict(report.to_dict()) == report


def test_recorded_clips_are_mostly_not_suspect(shared_motions):
    files = [shared_motions / "npz" / f"{name}.npz" for name in ("walking_1", "soccer_1")]
    assert [load_motion(file).report.suspect for file in files] == [False, False]
