"""Compare stereo rigs over a suite of motions: visibility, Cramer-Rao bounds, tracked errors.

Every rig of the grid that the sweeps span is bounded (`rig_bounds`); some, along the first
sweep, are tracked on simulated detections as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from tyro.conf import UseAppendAction, arg

from egocap.body.labels import EVALUATED, LABELS
from egocap.commandline import progress
from egocap.errors import InputError
from egocap.evaluation.table import Table, number
from egocap_eval.harness.study import Outcome
from egocap_eval.rig_design.rig_bounds import MODEL_ERROR_M, bound, track_errors
from egocap_eval.rig_design.rig_report import Candidate, RigReport
from egocap_eval.rig_design.rig_suite import SUITE, Motion, SuiteVisibility, load_suite
from egocap_eval.rig_design.rig_sweep import DEFAULTS, SIZE, Sweep, grid, make_rig, parse_sweep

USUAL = ("baseline=0.05:0.60:12", "fov=120:220:6")


def run_rig(
    sweeps: Sequence[Sweep],
    *,
    sigma: float,
    suite: Sequence[str] = SUITE,
    frames: int = 300,
    tracked: int = 0,
    seed: int = 0,
) -> RigReport:
    """Bound every rig of the grid that the sweeps span; track `tracked` of them, evenly along the
    first sweep with the other measures at the best rig's. Raises InputError, FileError."""
    measures = grid(sweeps)
    rigs = [make_rig(m) for m in measures]  # refuse before any work
    motions = load_suite(suite, frames)
    visibility = SuiteVisibility.of([motion.thinned() for motion in motions], rigs)
    candidates = []
    with progress("bounds", len(rigs), unit="rigs") as advance:
        for m, rig in zip(measures, rigs, strict=True):
            candidates.append(bound(m, rig, visibility, sigma))
            advance()
    settings = {"suite": list(suite), "frames_a_motion": frames, "sigma_px": sigma,
                "image_size": list(SIZE), "model_error_m": MODEL_ERROR_M, "seed": seed,
                "camera_places": len(visibility.places), "defaults": DEFAULTS}  # fmt: skip
    blocks = _blocks([motion.blocks[motion.every()] for motion in motions])
    report = RigReport(tuple(candidates), tuple(sweeps), blocks, settings)
    return _with_tracks(report, motions, sigma, tracked, seed) if tracked else report


def check_visibility(folders: Sequence[Path]) -> dict[str, float]:
    """Share of joints in view that rays see, or not, as the renderer does, by kind of joint.

    Joints occluded by others do not count. The people are rebuilt from the sequences' scenes.
    Raises FileError.
    """
    from egocap.data.sequence import open_sequence
    from egocap.data.truth import OCCLUDED, VISIBLE
    from egocap.geometry import inverse
    from egocap_eval.rig_design.ray_visibility import RayVisibility
    from egocap_sim.core.bodies import INDEX
    from egocap_sim.scene.config import load_scene
    from egocap_sim.world.world import World

    hits: dict[str, list[Array]] = {}
    for folder in folders:
        sequence = open_sequence(folder)
        truth = sequence.truth
        rays = RayVisibility(World(load_scene(sequence.folder / "scene.toml")).person)
        bodies = inverse(truth.T_world_body[:, INDEX["head"]])[:, None] @ truth.T_world_body
        shown = rays.shown(bodies, sequence.true_rig.T_head_camera[:, :3, 3])
        counts = truth.in_view & (truth.visibility != OCCLUDED)
        agree = shown == (truth.visibility == VISIBLE)
        for j in EVALUATED:
            kind = LABELS[j].rpartition("_")[2]
            hits.setdefault(kind, []).append(agree[..., j][counts[..., j]])
            hits.setdefault("all", []).append(agree[..., j][counts[..., j]])
    every = {kind: np.concatenate(parts) for kind, parts in hits.items()}
    return {kind: float(rows.mean()) for kind, rows in every.items() if len(rows)}


def _with_tracks(
    report: RigReport, motions: Sequence[Motion], sigma: float, count: int, seed: int
) -> RigReport:
    first, best = report.sweeps[0], report.best
    line = [
        c for c in report.candidates
        if all(c.measures[s.name] == best.measures[s.name] for s in report.sweeps[1:])
    ]  # fmt: skip
    line.sort(key=lambda c: c.measures[first.name])
    places = np.unique(np.linspace(0, len(line) - 1, min(count, len(line))).round().astype(int))
    chosen = {id(line[i]) for i in places}
    visibility = SuiteVisibility.of(motions, [make_rig(line[i].measures) for i in places])
    done: list[Candidate] = []
    with progress("tracks", len(chosen), unit="rigs") as advance:
        for c in report.candidates:
            if id(c) in chosen:
                c = replace(c, tracked=track_errors(make_rig(c.measures), visibility, sigma, seed))
                advance()
            done.append(c)
    blocks = _blocks([motion.blocks for motion in motions])
    return replace(report, candidates=tuple(done), track_blocks=blocks)


def _blocks(parts: Sequence[Float[Array, "T"]]) -> Float[Array, "B"]:
    """Number the motions' blocks through."""
    return np.concatenate([1e6 * i + part for i, part in enumerate(parts)])


def study(
    sweep: Annotated[
        tuple[tuple[str, ...], ...], UseAppendAction, arg(metavar="NAME=LOW:HIGH:COUNT ...")
    ] = (),
    sigma: float = 2.0,
    suite: tuple[str, ...] = SUITE,
    frames: int = 300,
    tracked: int = 0,
    seed: int = 0,
    check: tuple[Path, ...] = (),
    page: Path | None = None,
    figure: Path | None = None,
) -> Outcome:
    """Compare stereo rigs over a suite of motions: visibility, error bound, tracked error.

    Args:
        sweep: Measures to vary, NAME=LOW:HIGH:COUNT or NAME=VALUE: baseline, forward, up (metres),
            pitch, toe_out, fov (degrees); several after one --sweep, or --sweep again. The
            others are EgoRig1's. By default baseline=0.05:0.60:12 fov=120:220:6.
        sigma: Standard deviation of the detections, pixels at a width of 640.
        suite: Built-in scenes whose motions are simulated.
        frames: Frames of each.
        tracked: Number of rigs along the first sweep to track.
        seed: Seed of the tracked detections' noise.
        check: Rendered sequences on which to compare the visibility with the renderer's.
        page: HTML page of figures and the recommendation to write.
        figure: Figure of bound, posterior and error of the tracked rigs to write, png.
    """
    given = [text for group in sweep for text in group]
    if sweep and not given:
        raise InputError("--sweep without a measure", valid=f"such as {' '.join(USUAL)}")
    sweeps = [parse_sweep(text) for text in given or USUAL]
    if not 0.0 < sigma < np.inf:
        raise InputError(f"detections with sigma {sigma}", valid="above 0 px")
    if frames < 3 or tracked < 0 or seed < 0 or not suite:
        raise InputError(
            f"frames {frames}, tracked {tracked}, seed {seed}, {len(suite)} motions",
            valid="3 frames or more, a motion or more, the others from 0",
        )
    if figure is not None and (not tracked or figure.suffix != ".png"):
        raise InputError(f"--figure {figure}", valid="a .png file, with --tracked N")
    report = run_rig(sweeps, sigma=sigma, suite=suite, frames=frames, tracked=tracked, seed=seed)
    result = report.to_dict()
    tables = [report.to_table(), Table("", ("recommendation",), ((result["recommendation"],),))]
    if check:
        agree = check_visibility(check)
        result["visibility_agreement"] = {kind: round(share, 4) for kind, share in agree.items()}
        rows = tuple((kind, number(100 * share)) for kind, share in agree.items())
        tables.append(Table("Visibility as the renderer's, %", ("joint", "agree"), rows))
    if page is not None:
        from egocap_eval.rig_design.rig_plots import write_rig_page

        write_rig_page(page, report)
    if figure is not None:
        from egocap_eval.rig_design.rig_plots import save_together

        save_together(figure, report)
    return Outcome(result, tables)
