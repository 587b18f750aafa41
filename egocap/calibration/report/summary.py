"""The numbers of a calibration, as JSON values and as lines of text."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.calibration.rig_calibration import Calibration
from egocap.calibration.state import by_view


def corner_angles(calibration: Calibration) -> Float[Array, "N"]:
    """Angle off its camera's axis of every used corner, radians."""
    state, corners = calibration.adjusted.state, calibration.corners
    angles = np.empty(len(corners))
    for seen in by_view(state, corners, calibration.board.points):
        x, y, z = seen.points.T
        angles[seen.at] = np.arctan2(np.hypot(x, y), z)
    return angles


def summary(calibration: Calibration) -> dict[str, Any]:
    """Parameters with their standard deviations, residuals and coverage, as JSON values.

    Angles are in degrees, distances in metres, residuals in pixels.
    """
    angles = np.degrees(corner_angles(calibration))
    cameras = [_camera(calibration, v, angles) for v in range(len(calibration.views))]
    return {"board": str(calibration.board), "converged": calibration.adjusted.converged,
            "cameras": cameras,
            "poses": [_pose(calibration, v) for v in range(1, len(cameras))],
            "timing": timing(calibration)}  # fmt: skip


def timing(calibration: Calibration) -> dict[str, Any]:
    """Lag of each view but the first, and readout time of each [s], where they were estimated."""
    state, found = calibration.adjusted.state, {}
    for v, view in enumerate(calibration.views):
        own: dict[str, float] = {}
        if state.lag is not None and v > 0:
            std = calibration.lag_deviations()[v - 1]
            own |= {"lag_s": float(state.lag[v]), "deviation_s": float(std)}
        if state.readout is not None:
            std = calibration.readout_deviations()[v]
            own |= {"readout_s": float(state.readout[v]), "readout_deviation_s": float(std)}
        if own:
            found[view.view.name] = own
    return found


def lines(calibration: Calibration) -> list[str]:
    """The summary for a terminal."""
    found = summary(calibration)
    text = []
    for camera in found["cameras"]:
        text.append(
            f"{camera['name']}: {camera['model']}, {camera['pictures']} pictures, "
            f"{camera['corners']} corners to {camera['widest_degrees']:.0f} degrees off axis, "
            f"residual {camera['rms_px']:.3f} px"
            + (f", held out {camera['held_out_px']:.3f} px" if camera["held_out_px"] else "")
        )
        text += [f"    {name} = {p['value']:.6g} +- {p['deviation']:.2g}"
                 for name, p in camera["parameters"].items()]  # fmt: skip
    for pose in found["poses"]:
        text.append(
            f"{pose['from']} to {pose['to']}: {1000 * pose['distance_m']:.2f} mm apart "
            f"(+- {1000 * pose['deviation_m']:.2f}), turned by {pose['angle_degrees']:.3f} degrees "
            f"(+- {pose['deviation_degrees']:.3f}), from {pose['shared']} boards seen by both"
        )
    for name, t in found["timing"].items():
        if "lag_s" in t:
            text.append(f"{name}: {1000 * t['lag_s']:.2f} ms later than "
                        f"{found['cameras'][0]['name']} (+- {1000 * t['deviation_s']:.2f})"
                        )  # fmt: skip
        if "readout_s" in t:
            text.append(f"{name}: {1000 * t['readout_s']:.2f} ms from the first row to the last "
                        f"(+- {1000 * t['readout_deviation_s']:.2f})")  # fmt: skip
    return text


def _camera(calibration: Calibration, v: int, angles: Array) -> dict[str, Any]:
    view, state = calibration.views[v], calibration.adjusted.state
    shape, own = state.shapes[v], calibration.corners.view == v
    deviations = calibration.deviations(v)
    values = shape.published(state.lenses[v])
    residuals = calibration.adjusted.residuals[own]
    return {
        "name": view.view.name, "model": shape.title, "width": view.view.size[0],
        "height": view.view.size[1], "given": len(view.view.pictures),
        "pictures": len(np.unique(calibration.corners.instant[own])), "corners": int(own.sum()),
        "widest_degrees": float(angles[own].max()),
        "rms_px": float(np.sqrt(np.mean(residuals**2))),
        "held_out_px": view.choice.held_out.get(shape.title),
        "candidates": {k: e if np.isfinite(e) else None for k, e in view.choice.held_out.items()},
        "parameters": {name: {"value": float(value), "deviation": deviations[name]}
                       for name, value in zip(shape.names, values, strict=True)},
    }  # fmt: skip


def _pose(calibration: Calibration, v: int) -> dict[str, Any]:
    turn, shift = calibration.pose_deviations(v)
    T = calibration.adjusted.state.T_view_rig[v]
    corners = calibration.corners
    shared = np.intersect1d(corners.instant[corners.view == 0], corners.instant[corners.view == v])
    angle = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
    return {"from": calibration.views[0].view.name, "to": calibration.views[v].view.name,
            "T_to_from": T.tolist(), "distance_m": float(np.linalg.norm(T[:3, 3])),
            "deviation_m": float(np.linalg.norm(shift)), "angle_degrees": float(np.degrees(angle)),
            "deviation_degrees": float(np.degrees(np.linalg.norm(turn))),
            "shared": len(shared)}  # fmt: skip
