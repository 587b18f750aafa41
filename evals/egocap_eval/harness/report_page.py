"""A run's report: one self-contained HTML page (no network, a few megabytes), and Markdown."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.data.sequence import Sequence as Footage
from egocap.evaluation.pose_errors import PoseErrors
from egocap_eval.harness.result_file import git_commit, provenance, write_text
from egocap_eval.harness.suite import Suite
from egocap_eval.harness.thresholds import Numbers, paper_table, summary_tables

FRAMES_SHOWN = 300  # of a motion in the page at most; longer ones are thinned
WORST_SHOWN = 8
PICTURE_WIDTH = 420  # pixels of each view's picture
_NOT_PREDICTED = -32768
_TRUE, _PREDICTED = (59, 110, 168), (217, 128, 50)


@dataclass(frozen=True, eq=False)
class Run:
    """Result of a run of a suite; `scored` holds the predictions of every seed by
    "method/sequence"."""

    suite: Suite
    result: Mapping[str, Any]
    missed: Sequence[str]
    scored: Mapping[str, Sequence[PoseErrors]]
    sequences: Mapping[str, Footage]
    numbers: Numbers


def write_report(folder: Path, run: Run) -> None:
    """Write report.html and report.md into the folder of a run, each whole or not at all."""
    write_text(folder / "report.html", render_page(run))
    suite, numbers = run.suite, run.numbers
    tables = [*summary_tables(suite, numbers), *paper_table(suite, numbers, commands=True)]
    lines = [f"# {suite.name}", suite.description, *(f"- missed: {m}" for m in run.missed)]
    lines += [table.markdown() for table in tables]
    write_text(folder / "report.md", "\n\n".join(line for line in lines if line) + "\n")


def render_page(run: Run) -> str:
    """The page as self-contained HTML; pictures and motions are of the first seed."""
    from jinja2 import Environment, StrictUndefined

    first = {name: seeds[0] for name, seeds in run.scored.items()}
    here = files("egocap_eval.harness")
    motions = [_motion(name, s) for name, s in first.items()]
    page = Environment(autoescape=True, undefined=StrictUndefined).from_string(
        (here / "report.html").read_text(encoding="utf-8")
    )
    return page.render(
        suite=run.suite,
        lead=f"{len(run.suite.methods)} methods on {len(run.sequences)} sequences",
        missed=run.missed,
        left_out=run.result["left_out"],
        tables=summary_tables(run.suite, run.numbers, spread=True),
        charts=_charts(first),
        motions=motions,
        motions_json=json.dumps(motions).replace("<", "\\u003c"),
        bones=[list(pair) for pair in LIMBS],
        script=(here / "viewer.js").read_text(encoding="utf-8"),
        worst=_worst_frames(first, run.sequences),
        paper=run.result["paper"],
        provenance=_provenance(run.result),
    )


def _charts(first: Mapping[str, PoseErrors]) -> dict[str, Any]:
    from egocap_eval.harness import report_charts

    if not first:  # every sequence was left out
        return {"pck": "", "joints": [], "time": []}
    methods = list(dict.fromkeys(name.split("/")[0] for name in first))
    names = list(dict.fromkeys(name.split("/", 1)[1] for name in first))
    at = np.linspace(0, 200, 81)
    pck = {method: (at, _pck_curve([s for n, s in first.items() if n.split("/")[0] == method], at))
           for method in methods}  # fmt: skip
    joints = [_label(j) for j in next(iter(first.values())).protocol.joints]
    return {
        "pck": report_charts.lines(pck, x="distance, mm", y="% of joints", limits=(0, 101),
                            title="3-D PCK over all sequences; a joint not predicted is a miss"),
        "joints": [
            report_charts.bars(joints, {m: _per_joint(first[f"{m}/{name}"]) for m in methods
                                 if f"{m}/{name}" in first}, y="mm", title=name)
            for name in names
        ],
        "time": [
            report_charts.lines({m: (s.truth.times, s.per_frame) for m in methods
                          if (s := first.get(f"{m}/{name}")) is not None},
                         x="s", y="mm", title=name)
            for name in names
        ],
    }  # fmt: skip


def _pck_curve(of_sequences: Sequence[PoseErrors], at_mm: Float[Array, "N"]) -> Float[Array, "N"]:
    joints = list(of_sequences[0].protocol.joints)
    errors = np.concatenate(
        [1e3 * np.where(s.counted, s.joint_errors, np.inf)[:, joints].ravel() for s in of_sequences]
    )
    return 100.0 * np.searchsorted(np.sort(errors), at_mm, side="right") / len(errors)


def _per_joint(scored: PoseErrors) -> list[float | None]:
    means = [scored.mean([j]) for j in scored.protocol.joints]
    return [mean if np.isfinite(mean) else None for mean in means]


def _label(joint: int) -> str:
    side, _, part = LABELS[joint].rpartition("_")
    return f"{part} {side[:1].upper()}".strip()


def _motion(name: str, scored: PoseErrors) -> dict[str, Any]:
    """A motion for the page: 16-bit millimetres in base64, thinned to `FRAMES_SHOWN`."""
    step = -(-len(scored.truth.times) // FRAMES_SHOWN)
    rows = slice(None, None, step)
    errors = np.nan_to_num(scored.per_frame[rows], nan=-1.0)
    fps = (
        1.0 / float(np.median(np.diff(scored.truth.times))) if len(scored.truth.times) > 1 else 30.0
    )
    everywhere = np.ones_like(scored.valid)
    return {
        "name": name.replace("/", ", "), "frames": len(errors), "step": step, "fps": round(fps, 3),
        "errors": [round(float(e), 1) for e in errors],
        "truth": _packed(scored.truth.joints_head[rows], everywhere[rows]),
        "predicted": _packed(scored.predicted[rows], scored.valid[rows]),
    }  # fmt: skip


def _packed(points: Array, valid: Array) -> str:
    mm = np.clip(np.round(1e3 * np.where(valid[..., None], points, 0.0)), -32767, 32767)
    packed = np.where(valid[..., None], mm, _NOT_PREDICTED).astype("<i2")
    return base64.b64encode(packed.tobytes()).decode()


def _worst_frames(
    first: Mapping[str, PoseErrors], sequences: Mapping[str, Footage]
) -> list[dict[str, str]]:
    """The worst frame of every method and sequence, the worst first, with both poses drawn."""
    found = []
    for name, scored in first.items():
        errors = np.nan_to_num(scored.per_frame, nan=-1.0)
        frame = int(errors.argmax())
        found.append((float(errors[frame]), name, frame))
    found.sort(reverse=True)
    pictures = []
    for error, name, frame in found[:WORST_SHOWN]:
        sequence = sequences[name.split("/", 1)[1]]
        image = _overlay(sequence, first[name], frame)
        if image is not None:
            caption = f"{name.replace('/', ', ')}, frame {frame}: {error:.0f} mm"
            pictures.append({"image": image, "caption": caption})
    return pictures


def _overlay(sequence: Footage, scored: PoseErrors, frame: int) -> str | None:
    """All views side by side with true and predicted joints; None where there are no pictures."""
    import cv2

    from egocap.errors import FileError

    try:
        images = sequence.frame(frame).images
    except FileError:
        return None
    rig, views = sequence.true_rig, []
    everywhere = np.ones(len(LABELS), bool)
    for image, mount in zip(images, rig.mounts, strict=True):
        scale = PICTURE_WIDTH / image.shape[1]
        size = (PICTURE_WIDTH, round(image.shape[0] * scale))
        canvas = np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        index = rig.mounts.index(mount)
        poses = ((scored.truth.joints_head, everywhere, _TRUE),
                 (scored.predicted, scored.valid[frame], _PREDICTED))  # fmt: skip
        for joints, valid, color in poses:
            points = np.where(valid[:, None], joints[frame], 0.0)
            pixels, inside = rig.project(points)
            _draw_pose(canvas, (pixels[index] + 0.5) * scale - 0.5, inside[index] & valid, color)
        views.append(canvas)
    height = max(view.shape[0] for view in views)
    padded = [np.pad(v, ((0, height - v.shape[0]), (0, 0), (0, 0))) for v in views]
    picture = cv2.cvtColor(np.concatenate(padded, axis=1), cv2.COLOR_RGB2BGR)
    encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 82])[1]
    return "data:image/jpeg;base64," + base64.b64encode(encoded.tobytes()).decode()


def _draw_pose(canvas: Array, pixels: Array, shown: Array, color: tuple[int, int, int]) -> None:
    import cv2

    at = np.round(np.where(shown[:, None], pixels, 0.0)).astype(int)
    for a, b in LIMBS:
        if shown[a] and shown[b]:
            cv2.line(canvas, at[a].tolist(), at[b].tolist(), color, 2, cv2.LINE_AA)
    for point, ok in zip(at.tolist(), shown, strict=True):
        if ok:
            cv2.circle(canvas, point, 3, color, -1, cv2.LINE_AA)


def _provenance(result: Mapping[str, Any]) -> dict[str, str]:
    now = provenance()
    machine = now["machine"]
    return {
        "date": now["date"],
        "commit": git_commit() or "an installed package",
        "predictions made by commit": ", ".join(c for c in result["predicted_by"] if c) or "-",
        "machine": f"{machine['cpu']}, {machine['cores']} cores, {machine['memory_gb']} GB",
        "versions": ", ".join(f"{k} {v}" for k, v in now["versions"].items()),
        "sequences": ", ".join(f"{k} {v[:12]}" for k, v in result["sequences"].items()),
    }
