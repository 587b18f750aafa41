"""Advice to the person who records: what is missing in the pictures, and what looks wrong."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.calibration.flatness import bend
from egocap.calibration.report.summary import corner_angles
from egocap.calibration.rig_calibration import Calibration

SECTORS, RINGS = 8, 4
_BAD_PX = 0.5  # residual
_UNCERTAIN_PX = 0.3  # of the lens at the rim, one standard deviation
_LEAST_PICTURES = 15
_NEAR_M, _FAR_M = 0.05, 5.0  # of boards
_BASELINE_M = (0.01, 0.8)
_POSE_M, _POSE_RAD = 0.0005, np.deg2rad(0.03)  # standard deviations of a camera's pose
_LEAST_TILT = np.deg2rad(20.0)
_BENT_M, _SURE = 0.0005, 4.0  # height of an edge, and that over its standard deviation


def advice(calibration: Calibration) -> list[str]:
    """Sentences, the most important first; none where nothing is missing."""
    found: list[str] = []
    for v, view in enumerate(calibration.views):
        name = view.view.name
        found += [f"{name}: {text}" for text in _of_view(calibration, v)]
    return found + _of_bend(calibration) + _of_sizes(calibration) + _of_poses(calibration)


def lens_uncertainty(
    calibration: Calibration, view: int, theta: Float[Array, "n"]
) -> Float[Array, "n"]:
    """Standard deviation [px] of the projection at angles off the axis, averaged over azimuths.

    The turn of the camera that moves all pixels alike is part of it.
    """
    state = calibration.adjusted.state
    shape, lens = state.shapes[view], state.lenses[view]
    first = state.lens_columns[view]
    block = slice(first, first + len(lens))
    covariance = calibration.adjusted.covariance[block, block]
    azimuth = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    flat = np.stack(np.meshgrid(theta, azimuth, indexing="ij"), -1).reshape(-1, 2)
    across = np.stack([np.cos(flat[:, 1]), np.sin(flat[:, 1])], -1)
    rays = np.column_stack([np.sin(flat[:, :1]) * across, np.cos(flat[:, 0])])
    J = shape.project(rays, lens)[2]
    variance = np.einsum("nki,ij,nkj->n", J, covariance, J) / 2
    return np.sqrt(variance.reshape(len(theta), -1).mean(1))


def coverage(calibration: Calibration, view: int) -> Float[Array, "RINGS SECTORS"]:
    """Number of corners in rings and sectors about the middle of the image, to its corners."""
    width, height = calibration.views[view].view.size
    own = calibration.corners.view == view
    offset = calibration.corners.pixels[own] - (np.array([width, height]) - 1) / 2
    ring = np.linalg.norm(offset, axis=1) / (max(width, height) / 2) * RINGS
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi)
    sector = (turn * SECTORS + 0.5) % SECTORS
    counts = np.zeros((RINGS, SECTORS))
    at = np.minimum(ring.astype(int), RINGS - 1), sector.astype(int) % SECTORS
    np.add.at(counts, at, 1)
    return counts


def _of_view(calibration: Calibration, v: int) -> list[str]:
    own = calibration.corners.view == v
    camera = calibration.rig.cameras[v]
    widest = np.degrees(np.percentile(corner_angles(calibration)[own], 99.5))
    field = np.degrees(camera.max_angle)
    found = []
    pictures = len(np.unique(calibration.corners.instant[own]))
    if pictures < _LEAST_PICTURES:
        found.append(f"only {pictures} pictures are used: record {_LEAST_PICTURES} or more")
    if widest < min(field, 88.0) - 8.0:
        found.append(f"no corner beyond {widest:.0f} degrees of {field:.0f}: show the board near "
                     "the rim of the image")  # fmt: skip
    empty = np.flatnonzero(coverage(calibration, v)[1:3].sum(0) == 0)
    if len(empty):
        found.append(f"no corner towards the {_places(empty)}: show the board there")
    residual = calibration.adjusted.residuals[own]
    if (rms := float(np.sqrt(np.mean(residual**2)))) > _BAD_PX:
        found.append(f"the residual of {rms:.2f} px is large: is the board flat, are its counts "
                     "and sizes right, are the pictures sharp?")  # fmt: skip
    if float(lens_uncertainty(calibration, v, np.array([np.deg2rad(80.0)]))[0]) > _UNCERTAIN_PX:
        found.append("the lens is uncertain at 80 degrees: record more pictures near the rim")
    if _tilts(calibration, v).max(initial=0.0) < _LEAST_TILT:
        found.append("the board was never tilted: focal length and distance are hard to separate; "
                     "tilt it by 30 to 50 degrees")  # fmt: skip
    return found


def _of_sizes(calibration: Calibration) -> list[str]:
    distance = float(np.median(np.linalg.norm(_seen_boards(calibration), axis=1)))
    if _NEAR_M < distance < _FAR_M:
        return []
    return [f"the boards are {distance:.3g} m away: are the sizes in --board in metres?"]


def _of_bend(calibration: Calibration) -> list[str]:
    height, covariance = bend(calibration.adjusted, calibration.corners, calibration.board)
    most = float(np.abs(height).max())
    if most < _BENT_M or height @ np.linalg.solve(covariance, height) < 3 * _SURE**2:
        return []
    return [f"the board is bent by {1000 * most:.1f} mm: glue it to glass, aluminium or a hardback "
            "book and record again"]  # fmt: skip


def _of_poses(calibration: Calibration) -> list[str]:
    found = []
    for v in range(1, len(calibration.views)):
        name = calibration.views[v].view.name
        apart = float(np.linalg.norm(calibration.adjusted.state.T_view_rig[v][:3, 3]))
        if not _BASELINE_M[0] < apart < _BASELINE_M[1]:
            found.append(f"{name}: {apart:.3g} m from the first camera: are the sizes in --board "
                         "as printed, and the pictures of the same instants?")  # fmt: skip
        turn, shift = map(np.linalg.norm, calibration.pose_deviations(v))
        if shift > _POSE_M or turn > _POSE_RAD:
            found.append(f"{name}: its pose is uncertain by {1000 * shift:.1f} mm and "
                         f"{np.degrees(turn):.3f} degrees: show more boards to both cameras at "
                         "once; before fixed ones turn the rig by 40 degrees about every axis, in "
                         "twice as many pictures")  # fmt: skip
    return found


def _seen_boards(calibration: Calibration) -> Float[Array, "n 3"]:
    seen = np.unique(calibration.corners.instant)
    return calibration.adjusted.state.T_rig_board[seen, :3, 3]


def _tilts(calibration: Calibration, v: int) -> Float[Array, "n"]:
    """Angle between each board's normal and the line of sight to its middle, radians."""
    state = calibration.adjusted.state
    seen = np.unique(calibration.corners.instant[calibration.corners.view == v])
    T = state.T_view_rig[v] @ state.boards(v, seen)
    middle = np.append(calibration.board.points.mean(0), 1.0)
    sight = (T @ middle)[:, :3]
    cosine = (sight * T[:, :3, 2]).sum(1) / np.linalg.norm(sight, axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


_NAMES = ("right", "bottom right", "bottom", "bottom left", "left", "top left", "top", "top right")


def _places(sectors: Array) -> str:
    return ", ".join(_NAMES[s] for s in sectors)
