"""Record a board before a rig: a folder of pictures per camera, and a file of the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import simplejpeg
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.boards.board import Board
from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.files import make_folder, write_atomically, write_json
from egocap_sim.boards.path import BoardPath, draw_path
from egocap_sim.boards.picture import (
    Shot,
    background,
    camera_poses,
    draw_light,
    draw_room,
    exposure_times,
    take,
)
from egocap_sim.boards.settings import BoardRecording
from egocap_sim.boards.sheet import print_sheet
from egocap_sim.core.rng import make_rng
from egocap_sim.environment.panorama import make_panorama

TRUTH = "truth.json"
MOST_PICTURES = 10000


def record_board(
    board: Board,
    rig: Rig,
    settings: BoardRecording,
    out: Path,
    on_pictures: Callable[[int], None] = lambda count: None,
) -> None:
    """Write `out/VIEW/0000.jpg` of every view and `out/truth.json`.

    Pictures of the same name are taken together. Raises InputError for bad settings or an `out`
    that holds another recording.
    """
    if not 1 <= settings.count <= MOST_PICTURES:
        raise InputError(f"{settings.count} pictures", valid=f"1 to {MOST_PICTURES}")
    _require_possible(settings)
    if out.exists() and any(out.iterdir()):
        raise InputError(f"{out} is not empty", valid="a new folder")
    path, times = plan_board(board, rig, settings)
    rng = make_rng(settings.seed, "board.shot")
    sheet, panorama = print_sheet(board, rng), make_panorama(rng)
    T_world_rig, light = draw_room(rng), draw_light(board.size, rng)
    for v, mount in enumerate(rig.mounts):
        make_folder(out / mount.name)
        behind = background(mount.camera, panorama, T_world_rig @ mount.T_head_camera)
        for i, time in enumerate(times):
            if settings.rate == 0:
                light = draw_light(board.size, make_rng(settings.seed, f"board.light.{i}"))
            instants = exposure_times(time + settings.lag_s * (v > 0), mount.camera,
                                      settings.camera)  # fmt: skip
            poses = camera_poses(mount.T_head_camera, path.T_rig_board(instants))
            noise = make_rng(settings.seed, f"board.noise.{mount.name}.{i}")
            image = take(mount.camera, poses, Shot(sheet, _bend(board, settings.bend_m), light),
                         behind, settings.camera, noise)  # fmt: skip
            _write_picture(out / mount.name / f"{i:04d}.jpg", image, settings.camera.jpeg)
            on_pictures(1)
    write_truth(out / TRUTH, board, rig, settings, path.T_rig_board(times))


def _require_possible(settings: BoardRecording) -> None:
    """Raise InputError for numbers that no camera or board has."""
    camera = settings.camera
    numbers = {name: value for part in (settings, camera) for name, value in vars(part).items()
               if isinstance(value, int | float) and not isinstance(value, bool)}  # fmt: skip
    least = {"lag_s": -math.inf, "bend_m": -math.inf, "samples": 1, "exposures": 1, "jpeg": 1}
    most = {"jpeg": 100, "vignetting": 1}
    for name, value in numbers.items():
        low, high = least.get(name, 0), most.get(name, math.inf)
        if not (math.isfinite(value) and low <= value <= high):
            valid = f"{low:g} to {high:g}" if high < math.inf else f"a number from {low:g}"
            raise InputError(f"--{name.replace('_', '-')} {value:g}", valid=valid)


def plan_board(
    board: Board, rig: Rig, settings: BoardRecording
) -> tuple[BoardPath, Float[Array, "T"]]:
    """The path of the board, and the times of the pictures."""
    rng = make_rng(settings.seed, "board.path")
    if settings.rate == 0:
        path = draw_path(board, rig, settings.count, rng)
        return path, path.times
    seconds = settings.count / settings.rate
    return draw_path(board, rig, int(np.ceil(seconds)) + 1, rng), np.arange(
        settings.count
    ) / settings.rate


def write_truth(
    path: Path, board: Board, rig: Rig, settings: BoardRecording, poses: Float[Array, "T 4 4"]
) -> None:
    """Write the rig, the board and its poses T_rig_board, for scoring only."""
    write_json(path, {"rig": rig.to_dict(), "board": str(board), "lag_s": settings.lag_s,
                      "readout_s": settings.camera.readout_s, "bend_m": settings.bend_m,
                      "T_rig_board": poses.tolist()})  # fmt: skip


def _bend(board: Board, height: float) -> Float[Array, "2"]:
    """Curvature and middle of a sheet whose edges lie `height` behind its middle."""
    return np.array([8.0 * height / board.size[0] ** 2, board.size[0] / 2])


def _write_picture(path: Path, image: Array, quality: int) -> None:
    """Write a picture that its camera has compressed already, at a quality that adds little."""
    data = simplejpeg.encode_jpeg(
        np.ascontiguousarray(image), max(quality, 95), colorspace="RGB", colorsubsampling="444"
    )
    write_atomically(path, data)
