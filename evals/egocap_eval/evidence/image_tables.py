"""The tables of detection and of tracking from images; the test set comes first."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from egocap_eval.detection.detector import PAPER
from egocap_eval.evidence.page_table import Results, Row, interval, markdown, number
from egocap_eval.studies.recorded import DIGITS, FITTED, FITTED_WORLD, LAGGED, WORLD

SETS = {"recorded-test.json": "test", "recorded-validation.json": "validation"}
"""The sets of recorded motions, test first."""
TRACKED = ("offline", WORLD, FITTED, FITTED_WORLD, "live", LAGGED)
GROUPS = ("head", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
FRAMES = "detector.json"


def detection(results: Results) -> str:
    """PCK by joint of the recorded sets and of the validation frames, and the paper's."""
    header = ("within 20 px, %", *GROUPS, "all", "AUC", "error / stated")
    rows: list[Row] = []
    for kind, words in (("visible", "visible"), ("in_view", "in view")):
        for file, name in SETS.items():
            rows += results.rows(
                file,
                f"{name} set, {words}",
                lambda r, k=kind, w=words: [
                    (f"{set_label(r)}, {w}", *_group_means(r["mean"]["detector"], k))
                ],
            )
    for kind, words in (("visible", "visible"), ("in_view", "in view")):
        rows += results.rows(
            FRAMES,
            f"validation frames, {words}",
            lambda r, k=kind, w=words: [
                (
                    f"{r['frames']} validation frames, {w}",
                    *(number(r[k]["groups"][g]) for g in GROUPS),
                    number(r[k]["pck20"]),
                    number(r[k]["auc20"]),
                    number(r["spread"].get(k, {}).get("normalised_error"), 2),
                )
            ],
        )
    quoted = [number(PAPER.get(g)) for g in GROUPS]
    rows.append(Row(None, ("the paper, own footage, in view", *quoted, "89.5", "56.9", "-")))
    return markdown(header, rows, results)


def rigs(results: Results) -> str:
    """The detector on other rigs than its main one."""
    names = {
        "detector-ocam.json": "measured OCam lens",
        "detector-wide.json": "0.60 m apart",
        "detector-narrow.json": "130 degree lenses, 0.12 m apart",
        "detector-glasses.json": "glasses",
        "detector-headset4.json": "headset, four cameras",
        "detector-cap.json": "cap, one camera",
    }
    rows = [
        row
        for file, name in names.items()
        for row in results.rows(
            file,
            name,
            lambda r, n=name: [
                (
                    n,
                    *(number(r[k][m]) for k in ("visible", "in_view") for m in ("pck20", "auc20")),
                    number(r["spread"]["visible"]["normalised_error"], 2),
                )
            ],
        )
    ]
    header = ("rig", "PCK, visible", "AUC", "PCK, in view", "AUC", "error / stated, visible")
    return markdown(header, rows, results)


def poses(results: Results) -> str:
    """Errors of tracking from images, by part of the body and visibility."""
    parts = (
        "mpjpe_mm",
        "visible_mm",
        "hidden_mm",
        "arms_mm",
        "legs_mm",
        "ankles_mm",
        "feet_mm",
        "p95_mm",
    )
    rows = _by_case(results, TRACKED, lambda mean: (
        interval(mean["mpjpe_mm"]), *(number(mean[m]["mean"]) for m in parts[1:])
    ))  # fmt: skip
    header = (
        "mean error, mm",
        "all",
        "visible",
        "hidden",
        "arms",
        "legs",
        "ankles",
        "feet",
        "95th percentile",
    )
    return markdown(header, rows, results)


def in_world(results: Results) -> str:
    """Recorded clips in the world, with head poses found in the pictures."""
    units = {"world_aligned_mpjpe_mm": "mean error in the world, mm",
             "root_translation_percent": "hips' way, %", "foot_skate": "foot skate, m/s",
             "penetration_mm": "penetration, mm", "contact_f1": "contact F1"}  # fmt: skip
    rows = _by_case(results, (WORLD, FITTED_WORLD), lambda mean: tuple(
        number((mean[m] or {}).get("mean"), DIGITS.get(m, 1)) for m in units
    ))  # fmt: skip
    return markdown(("recorded clips", *units.values()), rows, results)


def _by_case(
    results: Results, cases: Sequence[str], cells: Callable[[Mapping[str, Any]], tuple[str, ...]]
) -> list[Row]:
    """A row for each set and case, with `cells` of the case's means."""
    return [
        row
        for file, name in SETS.items()
        for row in results.rows(
            file,
            f"{name} set",
            lambda r: [(f"{set_label(r)}, {case}", *cells(r["mean"][case]))
                       for case in cases if case in r["mean"]],
        )
    ]  # fmt: skip


def clips(results: Results) -> str:
    """Every recorded clip of the test and the validation set."""
    rows: list[Row] = []
    for file, name in SETS.items():
        rows += results.rows(
            file,
            f"{name} set",
            lambda r: (
                [
                    (
                        f"{r['set']}, {row['clip']}",
                        str(row["frames"]),
                        number(row["detector"]["pck20_visible"]),
                        number(row["detector"]["pck20_in_view"]),
                        *(number(row.get(case, {}).get("mpjpe_mm")) for case in TRACKED),
                    )
                    for row in r["rows"]
                ]
                + [
                    (f"{r['set']}, {clip}", f"left out: {why}")
                    for clip, why in r["left_out"].items()
                ]
            ),
        )
    header = (
        "clip",
        "frames",
        "PCK, visible",
        "PCK, in view",
        "offline, mm",
        *TRACKED[1:],
    )
    return markdown(header, rows, results)


def procedural(results: Results) -> str:
    """Tracking procedural motions from images."""
    header = (
        "mean error, mm",
        "frames",
        "body known",
        "body fitted",
        "average body",
        "arms, known",
        "legs, known",
    )
    rows = results.rows("personalised-validation.json", "scenes", _bodies)
    rows += results.rows(
        "recordings.json",
        "recordings",
        lambda r: [
            (
                name,
                _frames_of(r, name),
                number(e["mpjpe_mm"]),
                "-",
                "-",
                number(e["upper_mm"]),
                number(e["lower_mm"]),
            )
            for name, e in r["scores"]["learned"].items()
        ],
    )
    return markdown(header, rows, results)


def set_label(result: Mapping[str, Any]) -> str:
    """A set of recorded clips as a row names it."""
    return f"{result['set']} set, {len(result['rows'])} recorded clips"


def _group_means(means: Mapping[str, Any], kind: str) -> list[str]:
    groups = [number(means[f"{g}_{kind}"]["mean"]) if means[f"{g}_{kind}"] else "-" for g in GROUPS]
    ratio = means[f"normalised_error_{kind}"]["mean"]
    auc = means[f"auc20_{kind}"]["mean"]
    return [*groups, interval(means[f"pck20_{kind}"]), number(auc), number(ratio, 2)]


def _bodies(result: Mapping[str, Any]) -> Iterator[Sequence[str]]:
    scenes = dict.fromkeys(row["sequence"] for row in result["rows"])
    for scene in scenes:
        own = {row["body"]: row for row in result["rows"] if row["sequence"] == scene}
        yield (
            scene,
            str(own["true"]["frames"]),
            *(number(own[body]["mpjpe_mm"]) for body in ("true", "fitted", "average")),
            number(own["true"]["upper_mm"]),
            number(own["true"]["lower_mm"]),
        )


def _frames_of(result: Mapping[str, Any], name: str) -> str:
    return next(str(s["frames"]) for s in result["suite"]["sequences"] if s["name"] == name)
