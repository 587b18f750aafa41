"""Pictures of a board before one camera: background, sheet, lens blur, noise and JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.camera import Camera
from egocap.geometry import axis_angle, inverse
from egocap_sim.boards.board_kernel import cast
from egocap_sim.boards.settings import BoardCamera
from egocap_sim.boards.sheet import Sheet
from egocap_sim.environment.panorama import HEIGHT, WIDTH, Picture
from egocap_sim.render.pixel_rays import pixel_rays
from egocap_sim.sensor.light import compress, vignette
from egocap_sim.sensor.timing import row_time

_NEAR = np.deg2rad(4.0)  # rim around the sheet's pixels: its motion during the exposure
_ROOM = 0.35  # light of the background against the board's


@dataclass(frozen=True, eq=False)
class Shot:
    """What one picture shows: the sheet, its bend and its light."""

    sheet: Sheet
    bend: Float[Array, "2"]  # curvature [1/m], x at which it touches its plane [m]
    light: Float[Array, "6"]  # as board_kernel.cast


def background(camera: Camera, panorama: Picture, T_world_camera: Array) -> Float[Array, "H W 3"]:
    """Linear light of a panorama in a camera's picture."""
    rays, _ = pixel_rays(camera)
    world = rays @ T_world_camera[:3, :3].T
    column = (np.pi - np.arctan2(world[..., 1], world[..., 0])) / (2 * np.pi) * WIDTH - 0.5
    row = (np.pi / 2 - np.arcsin(np.clip(world[..., 2], -1, 1))) / np.pi * HEIGHT - 0.5
    seen = cv2.remap(panorama, column.astype(np.float32), row.astype(np.float32),
                     cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # fmt: skip
    return (_ROOM * (seen / 255.0) ** 2).astype(np.float32)


def exposure_times(time: float, camera: Camera, faults: BoardCamera) -> Float[Array, "H S"]:
    """Instants at which each row is exposed, for a picture whose middle row is at `time`."""
    rows = row_time(np.full(camera.height, time), np.arange(camera.height), camera.height,
                    faults.readout_s)  # fmt: skip
    within = ((np.arange(faults.exposures) + 0.5) / faults.exposures - 0.5) * faults.shutter_s
    return rows[:, None] + within


def take(
    camera: Camera,
    T_camera_board: Float[Array, "H S 4 4"],
    shot: Shot,
    behind: Float[Array, "H W 3"],
    faults: BoardCamera,
    rng: np.random.Generator,
) -> UInt8[Array, "H W 3"]:
    """The picture of a board at the poses of every row's exposure."""
    rays, theta = pixel_rays(camera)
    region = _region(rays, T_camera_board[camera.height // 2, 0], shot.sheet)
    light = behind.copy()
    if len(region):
        sheet = shot.sheet
        seen = cast(rays, region, np.ascontiguousarray(T_camera_board[..., :3, :]), sheet.texture,
                    np.array([*sheet.corner, sheet.texel]), shot.bend, shot.light,
                    faults.samples)  # fmt: skip
        at = region[:, 1], region[:, 0]
        light[at] = light[at] * (1 - seen[:, 3:]) + seen[:, :3]
    light *= (theta <= camera.max_angle)[..., None] * vignette(camera, faults.vignetting)[..., None]
    if faults.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), faults.blur_px)
    noise = rng.standard_normal(light.shape, np.float32) * faults.noise
    light += noise * np.sqrt(np.maximum(light, 0.02))
    image = np.rint(255 * np.sqrt(np.clip(light, 0.0, 1.0))).astype(np.uint8)
    return compress(image, faults.jpeg)


def draw_light(size: tuple[float, float], rng: np.random.Generator) -> Float[Array, "6"]:
    """Uneven light on a board: brightness, a gradient, and sometimes a glare."""
    slope = rng.uniform(-0.8, 0.8, 2) / max(size)
    brightness = rng.uniform(0.55, 0.95) / (1 + 0.5 * abs(slope * size).sum())
    glare = rng.uniform(0.05, 0.35) if rng.random() < 0.3 else 0.0
    return np.array([brightness, *slope, *(rng.random(2) * size), glare])


def draw_room(rng: np.random.Generator) -> Float[Array, "4 4"]:
    """T_world_rig: held with its cameras, which look down on a head, towards the horizon."""
    heading = axis_angle(np.array([0.0, 0.0, 1.0]), rng.uniform(0.0, 2 * np.pi))
    T = np.eye(4)
    T[:3, :3] = heading @ axis_angle(np.array([0.0, 1.0, 0.0]), rng.uniform(-1.6, -1.0))
    return T


def _region(rays: Array, T_camera_board: Array, sheet: Sheet) -> Array:
    """Columns and rows of the pixels that may see the sheet."""
    high, wide, _ = sheet.texture.shape
    x, y = np.linspace(0, wide, 9), np.linspace(0, high, 9)
    rim = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2) * sheet.texel + sheet.corner
    points = np.column_stack([rim, np.zeros(len(rim)), np.ones(len(rim))]) @ T_camera_board.T
    directions = points[:, :3] / np.linalg.norm(points[:, :3], axis=1, keepdims=True)
    middle = directions.mean(0) / np.linalg.norm(directions.mean(0))
    reach = np.arccos(np.clip(directions @ middle, -1, 1)).max() + _NEAR
    row, column = np.nonzero(rays @ middle > np.cos(min(reach, np.pi)))
    return np.column_stack([column, row])


def camera_poses(T_rig_camera: Array, T_rig_board: Float[Array, "*n 4 4"]) -> Array:
    """T_camera_board (*n, 4, 4) of a camera on the rig."""
    return inverse(T_rig_camera) @ T_rig_board
