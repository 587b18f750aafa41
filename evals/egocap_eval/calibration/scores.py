"""Errors of a calibration against the rig that was rendered."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.calibration.rig_calibration import Calibration
from egocap.cameras.camera import Camera
from egocap.cameras.rig import Rig
from egocap.geometry import inverse

FIELD = np.deg2rad(85.0)


def field_rays() -> Float[Array, "P 3"]:
    """Unit rays evenly over the solid angle up to 85 degrees off the axis."""
    cosine, azimuth = np.meshgrid(np.linspace(1.0, np.cos(FIELD), 60),
                                  np.linspace(0.0, 2 * np.pi, 48, endpoint=False))  # fmt: skip
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], -1).reshape(-1, 3)


def ray_errors(found: Camera, truth: Camera) -> tuple[dict[str, float], Float[Array, "3 3"]]:
    """Angles [degrees] between the rays of the truth's pixels, and the turn that aligns them.

    `aligned`: after that turn, which belongs to the pose of the camera.
    """
    rays = field_rays()
    pixels, valid = truth.project(rays)
    rays, (got, _) = rays[valid], found.ray(pixels[valid])
    R = Rotation.align_vectors(rays, got)[0].as_matrix()
    errors = {}
    for name, each in (("", got), ("aligned_", got @ R.T)):
        angle = np.degrees(2 * np.arcsin(np.linalg.norm(each - rays, axis=1) / 2))
        errors |= {f"{name}rms": float(np.sqrt(np.mean(angle**2))), f"{name}worst": angle.max()}
    return {key: float(value) for key, value in errors.items()}, R


def normalised_lens_error(calibration: Calibration, view: int, truth: Camera) -> float:
    """Root mean square of pixel errors over their stated standard deviations, in the field."""
    rays = field_rays()
    state = calibration.adjusted.state
    shape, lens = state.shapes[view], state.lenses[view]
    pixels, valid = truth.project(rays)
    first = state.lens_columns[view]
    block = slice(first, first + len(lens))
    got, _, J = shape.project(rays[valid], lens)
    variance = np.einsum("nki,ij,nkj->nk", J, calibration.adjusted.covariance[block, block], J)
    return float(np.sqrt(np.mean((got - pixels[valid]) ** 2 / variance)))


def pose_errors(calibration: Calibration, truth: Rig) -> dict[str, float]:
    """Errors of the second camera's pose from the first: mm, degrees, and normalised."""
    T = inverse(truth.T_head_camera[1]) @ truth.T_head_camera[0]
    found = calibration.adjusted.state.T_view_rig[1]
    turn = Rotation.from_matrix(found[:3, :3] @ T[:3, :3].T).as_rotvec()
    shift = found[:3, 3] - T[:3, 3]
    first = int(calibration.adjusted.state.lens_columns[-1])
    covariance = calibration.adjusted.covariance[first : first + 6, first : first + 6]
    step = np.concatenate([turn, shift])
    return {"millimetres": float(1000 * np.linalg.norm(shift)),
            "degrees": float(np.degrees(np.linalg.norm(turn))),
            "normalised": float(np.sqrt(step @ np.linalg.solve(covariance, step) / 6))}  # fmt: skip
