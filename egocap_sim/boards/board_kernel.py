"""Compiled ray casting of a board: every pixel's rays, spread over its area and its exposure."""

from __future__ import annotations

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

_ROUNDS = 6  # fixed-point iterations of a ray on a bent sheet


@numba.njit(cache=True)
def cast(
    rays: Float[Array, "H W 3"],
    region: Int[Array, "P 2"],
    poses: Float[Array, "H S 3 4"],
    texture: Float[Array, "h w 3"],
    frame: Float[Array, "3"],
    bend: Float[Array, "2"],
    light: Float[Array, "6"],
    samples: int,
) -> Float[Array, "P 4"]:
    """Light (RGB) and coverage of the pixels `region` (column, row).

    Each is the mean over `samples` x `samples` rays in the pixel and over the S poses of its row,
    T_camera_board. `frame`: x and y of the sheet's corner and the size of a texel. `bend`:
    curvature [1/m] and the x [m] at which the sheet touches its plane. `light`: brightness, its
    gradient along x and y [1/m], and x, y and strength of a glare.
    """
    height, width, _ = rays.shape
    out = np.zeros((len(region), 4), np.float32)
    count = poses.shape[1]
    for p in range(len(region)):
        i, j = region[p, 0], region[p, 1]
        for a in range(samples * samples):
            du = (a % samples + 0.5) / samples - 0.5
            dv = (a // samples + 0.5) / samples - 0.5
            # linear in the pixel: its error is the lens's curvature, below 1e-6 rad
            i2, j2 = i + (1 if du > 0 else -1), j + (1 if dv > 0 else -1)
            i2, j2 = min(max(i2, 0), width - 1), min(max(j2, 0), height - 1)
            x = rays[j, i, 0] + abs(du) * (rays[j, i2, 0] - rays[j, i, 0])
            x += abs(dv) * (rays[j2, i, 0] - rays[j, i, 0])
            y = rays[j, i, 1] + abs(du) * (rays[j, i2, 1] - rays[j, i, 1])
            y += abs(dv) * (rays[j2, i, 1] - rays[j, i, 1])
            z = rays[j, i, 2] + abs(du) * (rays[j, i2, 2] - rays[j, i, 2])
            z += abs(dv) * (rays[j2, i, 2] - rays[j, i, 2])
            for s in range(count):
                _add(out[p], x, y, z, poses[j, s], texture, frame, bend, light)
        for c in range(4):
            out[p, c] /= samples * samples * count
    return out


@numba.njit(cache=True)
def _add(
    total: Float[Array, "4"],
    x: float,
    y: float,
    z: float,
    pose: Float[Array, "3 4"],
    texture: Float[Array, "h w 3"],
    frame: Float[Array, "3"],
    bend: Float[Array, "2"],
    light: Float[Array, "6"],
) -> None:
    """Add what one ray of the camera sees of the sheet."""
    # ray and camera centre in the board frame
    dx = pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z
    dy = pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z
    dz = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z
    ox = -(pose[0, 0] * pose[0, 3] + pose[1, 0] * pose[1, 3] + pose[2, 0] * pose[2, 3])
    oy = -(pose[0, 1] * pose[0, 3] + pose[1, 1] * pose[1, 3] + pose[2, 1] * pose[2, 3])
    oz = -(pose[0, 2] * pose[0, 3] + pose[1, 2] * pose[1, 3] + pose[2, 2] * pose[2, 3])
    if abs(dz) < 1e-9:
        return
    t = -oz / dz
    if bend[0] != 0.0:
        for _ in range(_ROUNDS):
            off = ox + t * dx - bend[1]
            t = (0.5 * bend[0] * off * off - oz) / dz
    if t <= 0.0:
        return
    bx, by = ox + t * dx, oy + t * dy
    u = (bx - frame[0]) / frame[2] - 0.5
    v = (by - frame[1]) / frame[2] - 0.5
    high, wide, _ = texture.shape
    if u < 0 or v < 0 or u >= wide - 1 or v >= high - 1:
        return
    shade = light[0] * max(0.05, 1.0 + light[1] * bx + light[2] * by)
    apart = (bx - light[3]) ** 2 + (by - light[4]) ** 2
    glare = light[5] * np.exp(-apart / 0.0018)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    for c in range(3):
        value = 0.5  # the back of the sheet
        if dz > 0:
            top = texture[j, i, c] * (1 - a) + texture[j, i + 1, c] * a
            below = texture[j + 1, i, c] * (1 - a) + texture[j + 1, i + 1, c] * a
            value = top * (1 - b) + below * b
        total[c] += shade * value + glare
    total[3] += 1.0
