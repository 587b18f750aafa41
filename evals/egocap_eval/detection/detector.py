"""Accuracy, calibration and speed of the learned detector: the paper's Table 1 and Figure 7."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from tyro.conf import OmitArgPrefixes, Positional, arg

from egocap.body.labels import LABELS
from egocap.data.detections import Detections, load_detections
from egocap.data.input_checks import require_same_times
from egocap.data.sequence import open_sequence
from egocap.data.truth import VISIBLE
from egocap.errors import InputError
from egocap.evaluation.detection_scores import (
    LEVELS,
    auroc,
    calibration_error,
    coverage,
    median_normalised_error,
    normalised_error,
    reliability,
)
from egocap.evaluation.metrics import (
    auc,
    bootstrap_interval,
    mean_error,
    pck,
    percentile,
    pixel_errors,
)
from egocap.evaluation.table import Table, number
from egocap_eval.detection.detector_speed import measure_speed
from egocap_eval.harness.study import Outcome

if TYPE_CHECKING:
    from egocap.cameras.rig import Rig
    from egocap.data.sequence import Sequence
    from egocap.detect.detector import Detector

THRESHOLD = 20.0  # pixels at 640 x 512
CURVE = tuple(range(21))  # pixels
GROUPS = {
    "head": ("head", "neck"), "shoulder": ("shoulder",), "elbow": ("elbow",), "wrist": ("wrist",),
    "hand": ("hand",), "hip": ("hip",), "knee": ("knee",), "ankle": ("ankle",), "foot": ("foot",),
}  # fmt: skip
"""Columns of Table 1, and hands and feet."""
_LABELS_OF = {
    group: [i for i, name in enumerate(LABELS) if name.split("_")[-1] in names]
    for group, names in GROUPS.items()
}

PAPER = {
    "head": 84.7, "shoulder": 87.5, "elbow": 90.9, "wrist": 89.1, "hip": 97.7, "knee": 94.2,
    "ankle": 86.4, "pck20": 89.5, "auc20": 56.9,
}  # fmt: skip
TARGETS = {"pck20": 97.0, "auc20": 80.0, "wrist": 95.0, "ankle": 95.0}
SIGMA_TARGET, AUROC_TARGET, RATE_TARGET = 0.10, 0.90, 60.0
_BLOCK = 25  # frames with correlated errors


@dataclass(frozen=True, eq=False)
class Scored:
    """Detections and truth, lengths in pixels at image width 640."""

    errors: Float[Array, "T V 18"]  # meaningful where detected and in view
    sigma: Float[Array, "T V 18"]
    confidence: Float[Array, "T V 18"]
    detected: Bool[Array, "T V 18"]
    in_view: Bool[Array, "T V 18"]
    seen: Bool[Array, "T V 18"]


@dataclass(frozen=True)
class ValidationFrames:
    """The validation frames to score on."""

    validation: Annotated[Path | None, arg(metavar="DIR")] = None
    """Score on the 1000 validation frames in this folder; missing sequences are generated."""
    motions: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder of the clips of the validation frames; 250 of the 1000."""
    rig: Annotated[str | None, arg(metavar="NAME|FILE")] = None
    """Another rig for the validation frames."""
    workers: int = 1
    """Rendering processes for the validation frames."""

    def folders(self) -> list[Path]:
        """Its sequences, generated where they are missing; none without `validation`."""
        from egocap_eval.detection.validation_frames import make_validation

        if self.validation is None:
            return []
        return make_validation(
            self.validation, motions=self.motions, rig=self.rig, workers=self.workers
        )


@dataclass(frozen=True)
class DetectorOptions:
    """The detector to score."""

    weights: Annotated[Path | None, arg(metavar="FILE")] = None
    """Detector weights; those shipped by default."""
    engine: str = "auto"
    """auto (the fastest installed), onnxruntime, openvino, torch or cuda."""
    threads: int | None = None
    """Threads of the network; all cores by default."""

    def open(self, rig: Rig) -> Detector:
        """The detector for a rig. Raises as `Detector` does."""
        from egocap.detect.detector import Detector

        return Detector(rig, self.weights, self.engine, self.threads)  # type: ignore[arg-type]


def study(
    sequences: Positional[tuple[Annotated[Path, arg(metavar="SEQ")], ...]] = (),
    /,
    detections: Annotated[Path | None, arg(metavar="FILE")] = None,
    validation: Annotated[ValidationFrames, OmitArgPrefixes] = ValidationFrames(),
    network: Annotated[DetectorOptions, OmitArgPrefixes] = DetectorOptions(),
    frames: int | None = None,
    untimed: bool = False,
    picture: Annotated[Path | None, arg(metavar="FILE")] = None,
) -> Outcome:
    """Score the detector on sequences; exit code 3 when a target is missed.

    Args:
        sequences: Folders of sequences to score on.
        detections: Score these detections of the one sequence given; the detector is not run.
        validation: The validation frames to score on.
        network: The detector to score.
        frames: Only so many frames of each sequence, from the first.
        untimed: Do not measure the speed.
        picture: Draw the curves there, .png.
    """
    folders = [*sequences, *validation.folders()]
    if not folders:
        raise InputError("nothing to score on", valid="sequences, or --validation DIR")
    if detections is not None and len(folders) != 1:
        raise InputError(f"--detections with {len(folders)} sequences", valid="one")
    scored: dict[str, Scored] = {}
    config: dict[str, Any] = {"sequences": {}}
    speed: dict[str, Any] | None = None
    for folder in folders:
        sequence = open_sequence(folder)
        name = sequence.manifest.name
        if name in scored:  # episodes of a data set
            name = f"{name} {folder.name}"
        config["sequences"][name] = sequence.manifest.config_sha256
        if detections is not None:
            found = load_detections(detections)
        else:
            detector = network.open(sequence.rig)
            config["weights"] = detector.weights.sha256
            found = _detect(sequence, detector, frames)
            if speed is None and not untimed:
                speed = measure_speed(sequence, detector, network.threads)
        scored[name] = score(sequence, found)
    result = summary(scored) | {"speed": speed}
    if picture is not None:
        from egocap_eval.detection.detector_plots import draw

        draw(result, picture)
    return Outcome(result, tables(result), missed(result), config)


def score(sequence: Sequence, found: Detections) -> Scored:
    """Pair detections of a sequence's first frames with its truth. Raises InputError."""
    truth = sequence.truth
    rows = slice(0, len(found.times))
    require_same_times(found.times, truth.time[rows], "the detections")
    in_view = truth.in_view[rows]
    if found.valid.shape != in_view.shape:
        raise InputError(f"detections of {found.valid.shape[1]} views",
                         valid=f"{in_view.shape[1]}")  # fmt: skip
    widths = np.array([camera.width for camera in sequence.rig.cameras], float)
    both = (found.valid & in_view)[..., None]
    said, true = np.where(both, found.points, 0.0), np.where(both, truth.joints_2d[rows], 0.0)
    return Scored(
        errors=pixel_errors(said, true, widths),
        sigma=found.sigma * (640.0 / widths)[:, None],
        confidence=found.confidence,
        detected=found.valid,
        in_view=in_view,
        seen=in_view & (truth.visibility[rows] == VISIBLE),
    )


def summary(scored: Mapping[str, Scored]) -> dict[str, Any]:
    """All numbers, pooled over the sequences, and the main ones of each. JSON-ready."""
    pooled = Scored(*(
        np.concatenate([getattr(s, name) for s in scored.values()])
        for name in Scored.__dataclass_fields__
    ))  # fmt: skip
    return {
        "frames": len(pooled.errors),
        "visible": accuracy(pooled, pooled.seen, intervals=True),
        "in_view": accuracy(pooled, pooled.in_view),
        "spread": {
            "visible": _spread(pooled, pooled.seen),
            "hidden": _spread(pooled, pooled.in_view & ~pooled.seen),
        },
        "confidence": _confidence(pooled),
        "false_positives": _number(mean_error(pooled.detected, ~pooled.in_view)),
        "per_sequence": {
            name: {"frames": len(s.errors)} | {
                kind: {k: v for k, v in accuracy(s, counted).items() if k in _MAIN}
                for kind, counted in (("visible", s.seen), ("in_view", s.in_view))
            } for name, s in scored.items()
        },
        "paper": PAPER,
    }  # fmt: skip


def missed(result: Mapping[str, Any]) -> list[str]:
    """Descriptions of missed targets."""
    visible, found = result["visible"], []
    for name, least in TARGETS.items():
        value = visible["groups"][name] if name in GROUPS else visible[name]
        if value is not None and not value >= least:
            found.append(f"{name} of visible joints is {value:.1f}, not {least:g}")
    off = result["spread"]["visible"]["normalised_error"]
    if off is not None and not abs(off - 1.0) <= SIGMA_TARGET:
        found.append(f"normalised error of visible joints is {off:.2f}, not 0.9 to 1.1")
    area = result["confidence"]["occlusion_auroc"]
    if area is not None and not area >= AUROC_TARGET:
        found.append(f"AUROC of occlusion is {area:.3f}, not {AUROC_TARGET:g}")
    speed = result.get("speed")
    if speed and not speed["pairs_per_second"] >= RATE_TARGET:
        found.append(f"{speed['pairs_per_second']:.0f} pairs/s, not {RATE_TARGET:g}")
    return found


def tables(result: Mapping[str, Any]) -> list[Table]:
    """Tables of accuracy (with the paper's Table 1), sequences, calibration and speed."""
    header = ("", *GROUPS, "PCK", "AUC")
    rows = [("paper", *(number(PAPER.get(g)) for g in GROUPS), "89.5", "56.9")]
    for kind, name in (("visible", "visible joints"), ("in_view", "all in view")):
        found = result[kind]
        cells = [number(found["groups"][g]) for g in GROUPS]
        rows.append((name, *cells, number(found["pck20"]), number(found["auc20"])))
    made = [Table("PCK at 20 px of 640 x 512", header, tuple(rows))]
    each = tuple(
        (name, str(s["frames"]), *(number(s[k][m]) for k in ("visible", "in_view") for m in
         ("pck20", "auc20", "median_px")))
        for name, s in result["per_sequence"].items()
    )  # fmt: skip
    columns = ("sequence", "frames", "PCK", "AUC", "median px", "PCK in view", "AUC", "median px")
    made.append(Table("Each sequence", columns, each))
    spread, confidence = result["spread"], result["confidence"]
    rows = [
        (f"normalised error, {kind}", number(spread[kind]["normalised_error"], 2), "1")
        for kind in spread
    ]
    rows += [(f"the same by the median, {kind}", number(spread[kind]["by_median"], 2), "1")
             for kind in spread]  # fmt: skip
    rows += [
        ("AUROC of occlusion", number(confidence["occlusion_auroc"], 3), "0.9 or more"),
        ("confidence off by", number(confidence["calibration_error"], 3), "0"),
        ("found out of view", number(result["false_positives"], 3), "0"),
    ]
    made.append(Table("Calibration", ("measure", "value", "ideally"), tuple(rows)))
    parts = tuple(
        (kind, *(number(spread[kind]["groups"][g], 2) for g in GROUPS)) for kind in spread
    )
    made.append(Table("Normalised error by joint", ("", *GROUPS), parts))
    if speed := result.get("speed"):
        stages = tuple((s, number(ms, 2)) for s, ms in speed["stage_cpu_ms"].items())
        whole = ("all, overlapping", number(1e3 / speed["pairs_per_second"], 2))
        title = f"ms a pair: {speed['engine']}, {speed['threads']} threads, CPU time a stage"
        made.append(Table(title, ("stage", "ms"), (*stages, whole)))
    return made


_MAIN = ("pck20", "auc20", "median_px")


def accuracy(s: Scored, counted: Bool[Array, "T V 18"], intervals: bool = False) -> dict[str, Any]:
    """PCK, AUC and further measures of the counted joints; each group's too. JSON-ready."""
    found = s.errors, s.detected
    measured = s.detected & counted
    parts = {
        g: (s.errors[..., i], s.detected[..., i], counted[..., i]) for g, i in _LABELS_OF.items()
    }
    values: dict[str, Any] = {
        "joints": int(counted.sum()),
        "pck20": _number(pck(*found, counted, THRESHOLD)),
        "auc20": _number(auc(*found, counted, THRESHOLD)),
        "median_px": _number(percentile(s.errors, 50, measured)),
        "mean_px": _number(mean_error(s.errors, measured)),
        "missing": _number(mean_error(~s.detected, counted)),
        "groups": {g: _number(pck(*parts[g], THRESHOLD)) for g in parts},
        "group_auc": {g: _number(auc(*parts[g], THRESHOLD)) for g in parts},
        "per_joint": {
            n: _number(pck(s.errors[..., j], s.detected[..., j], counted[..., j], THRESHOLD))
            for j, n in enumerate(LABELS)
        },
        "curve": {str(t): _number(pck(*found, counted, float(t))) for t in CURVE},
        "group_curves": {g: [_number(pck(*parts[g], float(t))) for t in CURVE] for g in parts},
    }
    if intervals and len(s.errors) >= 2 * _BLOCK:
        hits = np.where(s.detected & (s.errors <= THRESHOLD), 100.0, 0.0)
        count = counted.sum((1, 2))
        per_frame = np.where(counted, hits, 0.0).sum((1, 2))[count > 0] / count[count > 0]
        if len(per_frame) >= 2 * _BLOCK:
            rng = np.random.default_rng(0)
            values["pck20_interval"] = list(bootstrap_interval(per_frame, rng, block=_BLOCK))
    return values


def _spread(s: Scored, counted: Bool[Array, "T V 18"]) -> dict[str, Any]:
    read = s.errors, s.sigma, s.detected & counted
    return {
        "joints": int(read[2].sum()),
        "normalised_error": _number(normalised_error(*read)),
        "groups": {
            g: _number(normalised_error(*(values[..., i] for values in read)))
            for g, i in _LABELS_OF.items()
        },
        "by_median": _number(median_normalised_error(*read)),
        "coverage": {f"{level:g}": _number(coverage(*read, level)) for level in LEVELS},
    }


def _confidence(s: Scored) -> dict[str, Any]:
    claimed, seen = s.confidence[s.in_view], s.seen[s.in_view]
    return {
        "occlusion_auroc": _number(auroc(claimed[seen], claimed[~seen])),
        "calibration_error": _number(calibration_error(claimed, seen)),
        "reliability": [list(row) for row in reliability(claimed, seen)],
    }


def _detect(sequence: Sequence, detector: Detector, frames: int | None) -> Detections:
    from egocap.commandline import progress

    count = min(frames or len(sequence), len(sequence))
    with progress(sequence.manifest.name, count) as advance:
        return detector.detect(sequence, frames=count, on_frames=advance)


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
