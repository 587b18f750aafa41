"""How exactly are lenses and camera poses calibrated from simulated pictures of a board?"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from egocap.boards.board import Board, parse_board
from egocap.calibration.rig_calibration import Calibration, calibrate
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import parse_rig
from egocap.evaluation.table import Table
from egocap_eval.calibration.lenses import (
    stereo_rig,
    study_lenses,
    with_symmetric_affine,
)
from egocap_eval.calibration.opencv import compare
from egocap_eval.calibration.scores import (
    normalised_lens_error,
    pose_errors,
    ray_errors,
)
from egocap_eval.calibration.synthetic import Fixed, fixed_boards, timed
from egocap_eval.harness.study import Outcome
from egocap_sim.boards.record import TRUTH, record_board
from egocap_sim.boards.settings import BoardRecording

TARGETS = {"ray_rms": 0.02, "ray_worst": 0.1, "millimetres": 0.5, "degrees": 0.03}
FIXED = (Fixed(20, 20, 0.6), Fixed(20, 20, 0.3), Fixed(40, 20, 0.6), Fixed(20, 40, 0.6),
         Fixed(40, 40, 0.6), Fixed(40, 40, 0.3))  # fmt: skip
"""The last one as advised."""
FIXED_COLUMNS = ("millimetres", "millimetres_std", "degrees", "degrees_std",
                 "degrees_std_known_lens", "normalised")  # fmt: skip
TIMED_RESTS = 25  # of the hand
_NORMALISED = (0.8, 1.25)
_NO_WORSE = 1.001  # of OpenCV's reprojection error


def study(
    folder: Path = Path("out/calibration"),
    measured: Path = Path("../shared/calibrations/egowholemocap_fisheye.json"),
    board: str = "charuco:5x7:0.0325:0.024",
    count: int = 40,
    seed: int = 100,
    synthetic: bool = False,
) -> Outcome:
    """Calibrate stereo rigs of five lenses from simulated boards and compare with the truth.

    With `synthetic`, only what --fixed-boards, --lag and --readout find, from corners alone.

    Args:
        folder: for the pictures; those of an earlier run are used again.
        measured: calibration file of the fifth lens; left out where it is missing.
        board: the board, as in `egocap calibrate`.
        count: pictures of each camera.
        seed: of the first recording; each lens has its own.
        synthetic: project corners with noise instead of rendering pictures.
    """
    if synthetic:
        return from_corners(parse_board(board), seed)
    rows = []
    for i, (name, camera) in enumerate(study_lenses(measured).items()):
        rig = stereo_rig(name, camera)
        recorded = folder / f"{name}-{count}-{seed + i}"
        if not (recorded / TRUTH).exists():
            settings = BoardRecording(count=count, seed=seed + i)
            record_board(parse_board(board), rig, settings, recorded)
        truth = parse_rig(json.loads((recorded / TRUTH).read_text())["rig"], recorded / TRUTH)
        truth = replace(truth, mounts=tuple(map(with_symmetric_affine, truth.mounts)))
        started = time.process_time()
        found = calibrate([recorded / view for view in rig.views], board)
        rows.append(_row(name, found, truth, time.process_time() - started))
    summary = _summary(rows)
    return Outcome({"lenses": rows, "summary": summary}, [_table(rows)], missed=_missed(summary))


def from_corners(board: Board, seed: int) -> Outcome:
    """Poses before fixed boards, lags and readout times from synthetic corners."""
    rig = stereo_rig("equidistant", study_lenses(None)["equidistant"])
    fixed = {str(case): fixed_boards(rig, board, case, np.random.default_rng([seed, i]))
             for i, case in enumerate(FIXED)}  # fmt: skip
    times = timed(rig, board, TIMED_RESTS, np.random.default_rng([seed, len(FIXED)]))
    rows = tuple((name, *(f"{f[k]:.4f}" for k in FIXED_COLUMNS)) for name, f in fixed.items())
    moving = tuple((name, f"{t['error_ms']:.3f}", f"{t['std_ms']:.3f}")
                   for name, t in times.items())  # fmt: skip
    tables = [
        Table("Fixed boards, from synthetic corners", ("rig turned", *FIXED_COLUMNS), rows),
        Table("Timing, from synthetic corners", ("time", "error ms", "std ms"), moving),
    ]
    advised = fixed[str(FIXED[-1])]
    over = [f"{unit} before fixed boards is {advised[unit]:.3g}, above {TARGETS[unit]:g}"
            for unit in ("millimetres", "degrees") if advised[unit] > TARGETS[unit]]  # fmt: skip
    return Outcome({"fixed_boards": fixed, "timing": times}, tables, missed=over)


def _row(name: str, found: Calibration, truth: Rig, seconds: float) -> dict[str, Any]:
    cameras = []
    for v, mount in enumerate(truth.mounts):
        errors, _ = ray_errors(found.rig.cameras[v], mount.camera)
        own = found.corners.view == v
        pixels = float(np.sqrt(np.mean(found.adjusted.residuals[own] ** 2)))
        cameras.append({"model": found.views[v].choice.shape.title, "rays_degrees": errors,
                        "normalised": normalised_lens_error(found, v, mount.camera),
                        "reprojection_px": pixels, "corners": int(own.sum()),
                        "opencv": compare(found, v)})  # fmt: skip
    return {"lens": name, "cameras": cameras, "pose": pose_errors(found, truth),
            "cpu_seconds": seconds}  # fmt: skip


def _summary(rows: list[dict[str, Any]]) -> dict[str, float]:
    cameras = [camera for row in rows for camera in row["cameras"]]
    squares = [c["normalised"] ** 2 for c in cameras]
    return {
        "ray_rms": max(c["rays_degrees"]["rms"] for c in cameras),
        "ray_worst": max(c["rays_degrees"]["worst"] for c in cameras),
        "millimetres": max(row["pose"]["millimetres"] for row in rows),
        "degrees": max(row["pose"]["degrees"] for row in rows),
        "normalised_lens": float(np.sqrt(np.mean(squares))),
        "normalised_pose": float(np.sqrt(np.mean([r["pose"]["normalised"] ** 2 for r in rows]))),
        "against_fisheye": _against(cameras, "fisheye_guided", "ours_fisheye"),
        "against_omnidir": _against(cameras, "omnidir", "ours_omnidir"),
        "fisheye_failed": sum(c["opencv"]["fisheye"] is None for c in cameras),
        "omnidir_failed": sum(c["opencv"]["omnidir"] is None for c in cameras),
    }


def _against(cameras: list[dict[str, Any]], theirs: str, ours: str) -> float:
    """Largest ratio of our reprojection error to OpenCV's, where it has one."""
    pairs = [(c["opencv"][ours], c["opencv"][theirs]) for c in cameras]
    return max((own / other for own, other in pairs if other is not None), default=0.0)


def _missed(summary: dict[str, float]) -> list[str]:
    low, high = _NORMALISED
    wrong = [f"{name} is {summary[name]:.3g}, above {most:g}"
             for name, most in TARGETS.items() if summary[name] > most]  # fmt: skip
    wrong += [f"{name} is {summary[name]:.4f}, above {_NO_WORSE:g}"
              for name in ("against_fisheye", "against_omnidir")
              if summary[name] > _NO_WORSE]  # fmt: skip
    return wrong + [f"{name} is {summary[name]:.2f}, not within {low:g} to {high:g}"
                    for name in ("normalised_lens", "normalised_pose")
                    if not low <= summary[name] <= high]  # fmt: skip


def _table(rows: list[dict[str, Any]]) -> Table:
    head = ("lens", "model", "rays, rms deg", "worst", "aligned rms", "normalised", "px",
            "fisheye px", "ours", "omnidir px", "ours", "pose mm", "pose deg", "CPU s")  # fmt: skip
    body = []
    for row in rows:
        for side, camera in zip(("left", "right"), row["cameras"], strict=True):
            rays, both = camera["rays_degrees"], camera["opencv"]
            shown = [f"{both[n]:.4f}" if both[n] is not None else "failed"
                     for n in ("fisheye", "ours_fisheye", "omnidir", "ours_omnidir")]  # fmt: skip
            body.append((f"{row['lens']} {side}", camera["model"], f"{rays['rms']:.4f}",
                         f"{rays['worst']:.4f}", f"{rays['aligned_rms']:.4f}",
                         f"{camera['normalised']:.2f}", f"{camera['reprojection_px']:.4f}", *shown,
                         f"{row['pose']['millimetres']:.3f}", f"{row['pose']['degrees']:.4f}",
                         f"{row['cpu_seconds']:.0f}"))  # fmt: skip
    return Table("Calibration from simulated boards", head, tuple(body))
