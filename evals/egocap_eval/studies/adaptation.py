"""Adapt the detector to footage of another camera, and measure it on other footage of that camera.

Every person is recorded with the `harsh` sensor preset and, where textures are given, in rooms of
photographic surfaces: one recording to adapt to, of which nothing but the images is used, and one
in another motion, with truth, to measure on. The same motion with the `clean` preset, in a room of
made surfaces, shows the gap that could be closed by weights that were trained in such a world. The
people have development seeds. The body is the average of their height, as weights that are not fit
for the footage fit no body to it. The rig is as calibrated: footage of another one is refused.
"""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from egocap.adaptation.adapt import adapt
from egocap.adaptation.config import AdaptOptions
from egocap.data.sequence import Sequence
from egocap.detect.detector import Detector
from egocap.detect.weights import open_weights
from egocap.errors import InputError
from egocap.evaluation.detection_scores import normalised_error
from egocap.evaluation.table import Table, number
from egocap_eval.detection.detector import accuracy, score
from egocap_eval.harness.footage import builtin_scene, content_hashes, prepare_sequence
from egocap_eval.harness.study import Outcome
from egocap_eval.studies.fit_body import person_height
from egocap_sim.scene.config import Scene
from egocap_sim.sensor.config import SensorTable

log = logging.getLogger(__name__)

SIZE = (640, 512)
FPS = 15
ADAPTED, MEASURED = ("squat", "gestures", "walk"), ("dribble", "hold")
CALIBRATED = dict.fromkeys((
    "calibration_rotation_deg", "calibration_translation_m", "calibration_focal",
    "calibration_centre_px",
), 0.0)  # fmt: skip
MEASURES = ("pck20_visible", "auc20_visible", "pck20_in_view", "auc20_in_view")
SHARE, HARM = 0.5, 0.3
"""Share of the gap in PCK of joints in view to close, and points of PCK that none may lose."""


def study(
    work: Path,
    people: int = 2,
    first_seed: int = 400980,
    seconds: float = 40.0,
    measured_seconds: float = 12.0,
    minutes: float = 10.0,
    textures: Path | None = None,
    weights: Path | None = None,
) -> Outcome:
    """Adapt the detector to people filmed by the harsh sensor; measure it on other motions.

    Args:
        work: Folder of the sequences and of the adapted weights.
        people: Number of people, with seeds from the first one.
        first_seed: Seed of the first person, 400000 to 409999.
        seconds: Length of the footage to adapt to.
        measured_seconds: Length of the footage to measure on.
        minutes: Training time.
        textures: Folder of photographic surfaces for the rooms.
        weights: Detector weights to start from; those shipped by default.
    """
    if not 400_000 <= first_seed <= 410_000 - people:
        raise InputError(f"people of seeds from {first_seed}", valid="400000 to 409999")
    rows, sequences = [], []
    for seed in range(first_seed, first_seed + people):
        footage, harsh, clean = (
            prepare_sequence(scene, work / scene.name, 1)
            for scene in scenes(seed, seconds, measured_seconds, textures)
        )
        sequences += [footage, harsh, clean]
        body = f"average:{person_height(footage.folder):.2f}"
        options = AdaptOptions(minutes=minutes, weights=weights, body=body)
        after, told = _adapted(footage.folder, work / f"adapted-{seed}", options)
        rows.append({
            "person": seed, "adaptation": told,
            "clean": scores(clean, weights), "clean, adapted": scores(clean, after),
            "harsh": scores(harsh, weights), "harsh, adapted": scores(harsh, after),
        })  # fmt: skip
    mean = {case: {m: float(np.mean([row[case][m] for row in rows])) for m in rows[0][case]}
            for case in ("clean", "clean, adapted", "harsh", "harsh, adapted")}  # fmt: skip
    closed = {m: _closed(mean, m) for m in MEASURES}
    result = {"rows": rows, "mean": mean, "gap_closed": closed, "minutes": minutes}
    config = content_hashes(sequences) | {"start": open_weights(weights).sha256}
    return Outcome(result, _tables(result), _missed(result), config)


def _adapted(footage: Path, out: Path, options: AdaptOptions) -> tuple[Path | None, dict[str, Any]]:
    """The weights after adaptation, those before where it refuses the footage, and its report.

    Nothing of an earlier one is taken over: other code may have made it.
    """
    shutil.rmtree(out, ignore_errors=True)
    try:
        made = adapt([footage], out, options)
    except InputError as error:
        log.warning("%s", error)
        return options.weights, {"kept": False, "refused": str(error)}
    assert made is not None  # not interrupted
    return made.weights or options.weights, made.to_dict() | {"weights": None}


def scenes(
    seed: int, seconds: float, measured: float, textures: Path | None
) -> tuple[Scene, Scene, Scene]:
    """Footage to adapt to, to measure on in the same world, and in a plain one."""
    base = builtin_scene("validation-walk", SIZE)
    surfaces = {} if textures is None else {"textures": str(textures.resolve())}
    harsh = ({"preset": "harsh"} | CALIBRATED, base.place.model_copy(update=surfaces))
    found = []
    for name, parts, length, (sensor, place) in (
        ("adapt", ADAPTED, seconds, harsh), ("harsh", MEASURED, measured, harsh),
        ("clean", MEASURED, measured, ({"preset": "clean"}, base.place)),
    ):  # fmt: skip
        found.append(base.model_copy(update={
            "name": f"adapt-{seed}-{name}", "seed": seed, "fps": FPS,
            "frames": round(length * FPS), "place": place,
            "motion": type(base.motion)(name="sequence", parameters={"parts": parts}),
            "sensor": SensorTable.model_validate(sensor),
        }))  # fmt: skip
    return found[0], found[1], found[2]


def scores(sequence: Sequence, weights: Path | None) -> dict[str, float]:
    """Accuracy of the detections of a sequence, and their normalised error."""
    scored = score(sequence, Detector(sequence.rig, weights).detect(sequence))
    found: dict[str, float] = {}
    for kind, counted in (("visible", scored.seen), ("in_view", scored.in_view)):
        values = accuracy(scored, counted)
        found |= {f"{name}_{kind}": values[name] for name in ("pck20", "auc20")}
    spread = normalised_error(scored.errors, scored.sigma, scored.seen & scored.detected)
    return found | {"normalised_error": spread}


def _closed(mean: dict[str, dict[str, float]], measure: str) -> float | None:
    gap = mean["clean"][measure] - mean["harsh"][measure]
    gain = mean["harsh, adapted"][measure] - mean["harsh"][measure]
    return None if gap <= 0 else gain / gap


def _missed(result: dict[str, Any]) -> list[str]:
    missed, closed = [], result["gap_closed"]["pck20_in_view"]
    if closed is not None and closed < SHARE:
        missed.append(f"{100 * closed:.0f} % of the gap closed, {100 * SHARE:.0f} asked")
    for row in result["rows"]:
        for case in ("clean", "harsh"):
            lost = row[case]["pck20_in_view"] - row[f"{case}, adapted"]["pck20_in_view"]
            if lost > HARM:
                missed.append(f"person {row['person']}, {case}: {lost:.1f} points lost")
    return missed


def _tables(result: dict[str, Any]) -> list[Table]:
    measures = (*MEASURES, "normalised_error")
    rows = [
        (str(row["person"]), case, *(number(row[case][m]) for m in measures))
        for row in result["rows"] for case in result["mean"]
    ]  # fmt: skip
    rows += [("mean", case, *(number(values[m]) for m in measures))
             for case, values in result["mean"].items()]  # fmt: skip
    header = ("person", "sensor and weights", *(m.replace("_", " ") for m in measures))
    labels = [(str(row["person"]), *_told(row["adaptation"])) for row in result["rows"]]
    return [
        Table("Detector before and after", header, tuple(rows)),
        Table("Adaptation", ("person", "kept", "images", "steps", "labelled %", "corrected %",
                             "gain held out", "standard error"), tuple(labels)),
    ]  # fmt: skip


def _told(made: dict[str, Any]) -> tuple[str, ...]:
    if "refused" in made:
        return "refused", *6 * ("-",)
    return (str(made["kept"]), str(made["images"]), str(made["steps"]),
            number(100 * made["labelled"]), number(100 * made["corrected"]), number(made["gain"]),
            number(made["gain_standard_error"]))  # fmt: skip
