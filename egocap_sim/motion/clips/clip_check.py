"""What is wrong with a recorded clip and what cleaning changed: a list of findings.

Anatomy (limits of every joint, elbows and knees that bend backwards, the neck), speed (cuts and
spikes) and the floor. A severe finding makes a clip suspect: much of it is repaired by assumption.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import JOINTS
from egocap.geometry import matrix_to_quaternion
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.clips.anatomy import NECK_LEAN, TOLERANCE, beyond_limits, neck_lean
from egocap_sim.motion.clips.cleaning import sole_heights, to_local
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.figure import SOLE_TIP, positions

RARE = 0.01  # of the frames: no finding below
SEVERE = 0.10  # of the frames
SEVERE_CUT = 0.25
SUNK_M, RAISED_M = 0.08, 0.30  # sole below the floor; lower sole above it
SHIFT_M = 0.05
_TIPS: Mapping[str, tuple[float, float, float]] = {
    "head": (0.0, 0.0, 0.2), "l_hand": (0.0, 0.0, -0.18), "r_hand": (0.0, 0.0, -0.18),
    "l_toe": tuple(SOLE_TIP), "r_toe": tuple(SOLE_TIP),
}  # fmt: skip
_LIMITS = {d.name: (d.lower_deg, d.upper_deg) for joint in JOINTS for d in joint.dofs}


@dataclass(frozen=True)
class Finding:
    """One fault of a clip, and what was done about it."""

    kind: str  # cut, speed, reversed, angle, neck, sunk, raised or floor
    where: str  # a body, an angle, or 'clip'
    share: float  # of the frames; of a reversed hinge, of its flexed frames
    worst: float | None  # degrees beyond the limit, rad/s, or metres
    text: str
    change: str = ""  # empty: unchanged
    severe: bool = False

    def __str__(self) -> str:
        return f"{self.text} ({100 * self.share:.0f} %)" + (f": {self.change}" * bool(self.change))


@dataclass(frozen=True)
class ClipReport:
    """The findings of a clip, and how far cleaning moved it."""

    name: str
    frames: int  # kept
    fps: float
    findings: tuple[Finding, ...]
    moved_cm: float  # mean over joints and frames, on the standard figure, pelvis fixed
    moved_max_cm: float

    @property
    def suspect(self) -> bool:
        """Whether a finding is severe."""
        return any(finding.severe for finding in self.findings)

    @property
    def verdict(self) -> str:
        """'good' (no pose changed), 'repaired' or 'suspect'."""
        if self.suspect:
            return "suspect"
        repaired = any(f.change and f.kind != "floor" for f in self.findings)
        return "repaired" if repaired else "good"

    def severe_text(self) -> str:
        """The severe findings in one line."""
        return "; ".join(str(finding) for finding in self.findings if finding.severe)

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"verdict": self.verdict}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> ClipReport:
        """The report of `to_dict`."""
        known = {k: v for k, v in data.items() if k not in ("verdict", "findings")}
        return cls(**known, findings=tuple(Finding(**f) for f in data["findings"]))


def check_clip(
    raw: Clip,
    posed: Clip,
    clean: Clip,
    trimmed: int,
    hinges: Mapping[str, float],
    shift: float,
) -> ClipReport:
    """Compare the stages of cleaning.

    Args:
        raw: the canonical clip as recorded, without the frames outside its longest take.
        posed: without spikes.
        clean: with all repairs.
        trimmed: frames outside the longest take.
        hinges: reversed elbows and knees, and the share of their flexed frames (`anatomy`).
        shift: metres by which the clip was raised to stand on the floor.
    """
    found = [
        *_cuts(len(raw.positions), trimmed), *_spikes(raw, posed), *_hinges(hinges),
        *_angles(posed, clean, hinges), *_neck(posed), *_floor(clean, shift),
    ]  # fmt: skip
    moved = 100 * np.linalg.norm(_figure_points(clean) - _figure_points(raw), axis=-1)
    return ClipReport(
        raw.name, len(raw.positions), raw.fps, tuple(found), float(moved.mean()), float(moved.max())
    )


def _cuts(kept: int, trimmed: int) -> Iterator[Finding]:
    if trimmed:
        share = trimmed / (kept + trimmed)
        text = "frames before or after a cut"
        yield Finding("cut", "clip", share, None, text, "dropped", share > SEVERE_CUT)


def _spikes(raw: Clip, posed: Clip) -> Iterator[Finding]:
    """Bodies whose rotation to the parent was despiked."""
    before, after = to_local(raw.rotations), to_local(posed.rotations)
    changed = np.abs(before - after).max((2, 3)) > 1e-6
    for b in np.flatnonzero(changed.mean(0) > RARE):
        q = matrix_to_quaternion(before[:, b])
        step = 2 * np.arccos(np.clip(np.abs((q[1:] * q[:-1]).sum(1)), 0.0, 1.0))
        share, speed = float(changed[:, b].mean()), float(step.max(initial=0.0) * raw.fps)
        text = f"{_plain(BODIES[b])} jumps at up to {speed:.0f} rad/s"
        yield Finding("speed", BODIES[b], share, speed, text, "interpolated", share > SEVERE)


def _hinges(hinges: Mapping[str, float]) -> Iterator[Finding]:
    for hinge, share in hinges.items():
        text = f"{hinge.replace('_', ' ')} bends backwards when flexed"
        yield Finding(
            "reversed", hinge, share, None, text, "bent as much the other way", severe=True
        )


def _angles(posed: Clip, clean: Clip, hinges: Mapping[str, float]) -> Iterator[Finding]:
    """Angles beyond their limits; of a limb with a reversed hinge, those that remain."""
    before, after = beyond_limits(posed), beyond_limits(clean)
    explained = {
        f"{hinge.split('_')[0]}_{joint}"
        for hinge in hinges
        for joint in (
            ("shoulder", "elbow", "wrist") if "elbow" in hinge else ("hip", "knee", "ankle")
        )
    }
    for name in before:
        excess = (after if name.rpartition("_")[0] in explained else before)[name]
        share = float((excess > 0).mean())
        if share < RARE:
            continue
        low, high = _LIMITS[name]
        worst = float(np.rad2deg(excess.max() + TOLERANCE))
        text = f"{name.replace('_', ' ')} up to {worst:.0f} deg beyond {low:g} to {high:g} deg"
        less = (after[name] > 0).mean() < 0.5 * share
        yield Finding("angle", name, share, worst, text, "repaired" if less else "", share > SEVERE)


def _neck(posed: Clip) -> Iterator[Finding]:
    lean = neck_lean(posed)
    share = float((lean > NECK_LEAN).mean())
    if share > RARE:
        worst = float(np.rad2deg(lean.max()))
        text = f"the neck leans {worst:.0f} deg off the trunk"
        yield Finding("neck", "neck", share, worst, text, severe=share > SEVERE)


def _floor(clean: Clip, shift: float) -> Iterator[Finding]:
    if abs(shift) > SHIFT_M:
        text = f"floor at {-shift:.2f} m"
        yield Finding("floor", "clip", 1.0, -shift, text, "moved to 0")
    sole = sole_heights(clean)
    for kind, far, text in (
        ("sunk", sole < -SUNK_M, f"a sole {-sole.min():.2f} m under the floor"),
        ("raised", sole > RAISED_M, f"both soles up to {sole.max():.2f} m above the floor"),
    ):
        if far.mean() > RARE:
            worst = float(-sole.min() if kind == "sunk" else sole.max())
            severe = kind == "sunk" and bool(far.mean() > SEVERE)
            yield Finding(kind, "clip", float(far.mean()), worst, text, severe=severe)


def _figure_points(clip: Clip) -> Float[Array, "T 26 3"]:
    """Joints and tips of the standard figure in the clip's pose, from the pelvis, metres."""
    R = clip.rotations
    joints = positions(R, np.zeros((len(R), 3)))
    tips = [joints[:, INDEX[b]] + R[:, INDEX[b]] @ np.array(tip) for b, tip in _TIPS.items()]
    return np.concatenate([joints, np.stack(tips, 1)], 1)


def _plain(body: str) -> str:
    return {"l_": "left ", "r_": "right "}.get(body[:2], body[:2]) + body[2:]
