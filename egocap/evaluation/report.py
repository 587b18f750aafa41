"""The result of an evaluation, and how it is written: text, Markdown or JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from html import escape
from typing import Any

from egocap.evaluation.detection_scores import DetectionScore
from egocap.evaluation.table import Table, number

UNITS: Mapping[str, str] = {
    "*_mm": "millimetres",
    "accel_error": "m/s^2",
    "world_accel_error": "m/s^2",
    "velocity_error, foot_skate": "m/s",
    "pck3d_*, auc3d_*": "percent, at 100 or 150 mm; AUC to 150 mm",
    "contact_f1*": "0 to 1",
    "root_translation_percent": "percent of the way of the hips",
    "pck20, auc20": "percent, at 20 px of 640 x 512",
    "*_px": "pixels at 640 x 512",
    "*_share": "0 to 1",
    "tracker_fps": "frames a second of solver time on one core",
}


@dataclass(frozen=True, repr=False)
class Report:
    """Errors of one track on one sequence. None means that there was nothing to measure.

    `pck20` and `auc20` are those of the detections the track was made from, when they were given;
    `reprojection` scores the track's own joints projected back into the views.
    """

    mpjpe_mm: float  # mean error of the protocol's joints
    pa_mpjpe_mm: float | None  # after a similarity a frame; None: too few joints in a frame
    upper_mm: float | None  # shoulders, elbows, wrists, hands
    lower_mm: float | None  # hips, knees, ankles, feet
    median_mm: float
    p95_mm: float
    accel_error: float | None  # mean acceleration error: jitter
    per_joint_mm: Mapping[str, float | None]
    visible_share: float | None  # of joints and frames, seen by at least one camera
    frames: int
    protocol: str
    protocol_description: str
    pck20: float | None = None
    auc20: float | None = None
    mpjpe_ci95_mm: tuple[float, float] | None = None  # block bootstrap, blocks of a second
    visible_mm: float | None = None  # joints seen by at least one camera
    hidden_mm: float | None = None  # joints seen by none
    max_mm: float | None = None
    bone_error_mm: float | None = None  # mean absolute error of bone lengths
    bone_drift_mm: float | None = None  # mean standard deviation over time of bone lengths
    p90_mm: float | None = None
    p99_mm: float | None = None
    pck3d_100: float | None = None  # joints within 100 mm; a joint not predicted is a miss
    pck3d_150: float | None = None
    auc3d_150: float | None = None  # area under the 3-D PCK curve to 150 mm
    velocity_error: float | None = None
    foot_skate: float | None = None  # of planted toes, own head pose if there is one, or the true
    penetration_mm: float | None = None  # of ankles and toes, likewise
    contact_f1: float | None = None  # of planted feet, likewise
    contact_f1_of_truth: float | None = None  # what true joints score by the same rule
    world_mpjpe_mm: float | None = None  # own head pose, first frame aligned
    world_aligned_mpjpe_mm: float | None = None  # all frames aligned, rigidly
    root_translation_percent: float | None = None  # of the way of the hips
    world_accel_error: float | None = None
    frames_in_world: int | None = None  # with a head pose of the method's own
    coverage_share: float | None = None  # joints of the protocol that were predicted
    other_protocols_mm: Mapping[str, float] = field(default_factory=dict)
    detections: DetectionScore | None = None
    reprojection: DetectionScore | None = None
    tracker_fps: float | None = None
    converged_share: float | None = None
    detections_source: str | None = None
    body: str | None = None  # whose bones the track has: true, fitted, average or a file
    method: str | None = None  # of predictions from elsewhere
    warnings: tuple[str, ...] = ()  # what another reading of the predictions would explain
    provenance: Mapping[str, Any] = field(default_factory=dict)  # files, versions
    units: Mapping[str, str] = field(default_factory=lambda: dict(UNITS))

    def __repr__(self) -> str:
        return (f"<Report: {self.protocol}, {self.frames} frames, MPJPE {self.mpjpe_mm:.1f} mm, "
                f"PA-MPJPE {number(self.pa_mpjpe_mm)} mm>")  # fmt: skip

    def __str__(self) -> str:
        return f"{self.heading()}\n\n{self._summary().text()}"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.heading())}</p>{self._summary().html()}"

    def to_dict(self) -> dict[str, Any]:
        """All fields, JSON-ready."""
        return asdict(self)

    def to_json(self) -> str:
        """The fields as a JSON object; what was not measured is null."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)

    def to_text(self) -> str:
        """Aligned plain text for a terminal."""
        return "\n\n".join([self.heading(), *(table.text() for table in self.tables())])

    def to_markdown(self) -> str:
        """Markdown with pipe tables."""
        return "\n\n".join([self.heading(), *(table.markdown() for table in self.tables())])

    def tables(self) -> list[Table]:
        """What the text and the Markdown show, in order."""
        tables = [self._summary(), self._per_joint()]
        if self.other_protocols_mm:
            rows = tuple((name, number(v)) for name, v in self.other_protocols_mm.items())
            tables.append(Table("The same joints aligned", ("protocol", "MPJPE mm"), rows))
        if scores := [s for s in (self.detections, self.reprojection) if s is not None]:
            tables.append(_detection_table(scores))
        return tables

    def heading(self) -> str:
        """Protocol with its alignment, frames, detector and body in one line; warnings below."""
        source = f"; {self.method}" if self.method else ""
        source += f"; detections {self.detections_source}" if self.detections_source else ""
        source += f"; body {self.body}" if self.body else ""
        first = f"{self.protocol}: {self.protocol_description}; {self.frames} frames{source}"
        return "\n".join([first, *(f"Warning: {warning}" for warning in self.warnings)])

    def _summary(self) -> Table:
        low_high = self.mpjpe_ci95_mm
        interval = "" if low_high is None else f"95 %: {low_high[0]:.1f} to {low_high[1]:.1f}"
        rows = [
            ("MPJPE", number(self.mpjpe_mm), "mm", interval),
            ("PA-MPJPE", number(self.pa_mpjpe_mm), "mm", "each frame aligned, with scale"),
            ("upper body", number(self.upper_mm), "mm", "shoulders to hands"),
            ("lower body", number(self.lower_mm), "mm", "hips to feet"),
            ("median", number(self.median_mm), "mm", "over joints and frames"),
            ("95th percentile", number(self.p95_mm), "mm", ""),
            ("99th percentile", number(self.p99_mm), "mm", ""),
            ("worst", number(self.max_mm), "mm", ""),
            ("joints predicted", self._coverage(), "%", "measures are of these"),
            ("3-D PCK at 150 mm", number(self.pck3d_150), "%", "joints not predicted are misses"),
            ("3-D PCK at 100 mm", number(self.pck3d_100), "%", ""),
            ("3-D AUC to 150 mm", number(self.auc3d_150), "%", ""),
            ("seen joints", number(self.visible_mm), "mm", "by at least one camera"),
            ("hidden joints", number(self.hidden_mm), "mm", "seen by no camera"),
            ("seen share", number(_percent(self.visible_share)), "%", "of joints and frames"),
            ("velocity error", number(self.velocity_error, 3), "m/s", ""),
            ("acceleration error", number(self.accel_error, 2), "m/s^2", "jitter"),
            ("world MPJPE", number(self.world_mpjpe_mm), "mm", "first frame aligned"),
            ("world MPJPE", number(self.world_aligned_mpjpe_mm), "mm", "all frames aligned"),
            ("root translation", number(self.root_translation_percent, 2), "%", "of its way"),
            ("jitter in the world", number(self.world_accel_error, 2), "m/s^2", ""),
            ("foot skate", number(self.foot_skate, 3), "m/s", f"planted toes, {self._pose()}"),
            ("penetration", number(self.penetration_mm), "mm", "ankles and toes, the same"),
            ("contact F1", number(self.contact_f1, 2), "", self._f1_note()),
            ("bone length error", number(self.bone_error_mm), "mm", ""),
            ("bone length drift", number(self.bone_drift_mm), "mm", "standard deviation in time"),
            ("PCK at 20 px", number(self.pck20), "%", self._detections_note()),
            ("AUC to 20 px", number(self.auc20), "%", self._detections_note()),
            ("frames converged", number(_percent(self.converged_share)), "%", ""),
            ("tracker", number(self.tracker_fps, 0), "frames/s", "solver, one core"),
        ]
        shown = tuple(row for row in rows if row[1] != "-")
        return Table("", ("measure", "value", "unit", "note"), shown)

    def _pose(self) -> str:
        if self.frames_in_world is None:
            return "head pose true"
        return f"head pose of the track, {self.frames_in_world} frames"

    def _coverage(self) -> str:
        share = self.coverage_share
        return "-" if share is None or share == 1.0 else number(100 * share)

    def _f1_note(self) -> str:
        return f"true joints by the same rule: {number(self.contact_f1_of_truth, 2)}"

    def _detections_note(self) -> str:
        return self.detections.source if self.detections is not None else ""

    def _per_joint(self) -> Table:
        names = dict.fromkeys(_split(name)[1] for name in self.per_joint_mm)
        errors = {_split(name): value for name, value in self.per_joint_mm.items()}
        rows = tuple(
            (part, *(_cell(errors.get((side, part))) for side in ("left", "", "right")))
            for part in names
        )
        return Table("Error per joint, mm", ("joint", "left", "middle", "right"), rows)


def _detection_table(scores: list[DetectionScore]) -> Table:
    header = ("image points", "PCK@20", "AUC@20", "PCK@20 seen", "median px", "missing %")
    rows = tuple(
        (
            score.source,
            number(score.pck20),
            number(score.auc20),
            number(score.pck20_seen),
            number(score.median_px, 2),
            number(_percent(score.missing_share)),
        )
        for score in scores
    )
    return Table(scores[0].protocol, header, rows)


def _cell(error: float | None) -> str:
    return "" if error is None else number(error)


def _split(label: str) -> tuple[str, str]:
    side, _, part = label.rpartition("_")
    return side, part


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share
