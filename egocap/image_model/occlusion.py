"""Visibility of a posed person's joints in a rig, predicted from the volumetric body.

A joint in view is visible when the optical depth of the body's other parts between it and the
camera is small. The parts that meet at the joint surround it and occlude it only where they are
clearly in front of it: a thigh seen from above occludes its own knee.
Checked against the renderer's visibility by `egocap-eval rig --check`.

Source: EgoCap 2016, equation 4 (transmittance through Gaussians).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numba import njit, prange
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.image_model.body_kernel import gaussian_centres

DEPTH = 0.6
"""Optical depth of other parts beyond which a joint counts as occluded."""
MARGINS: dict[str, float] = {
    "head": 0.13, "neck": 0.17, "shoulder": 0.2, "elbow": 0.3, "wrist": 0.13, "hand": 0.13,
    "hip": 0.2, "knee": 0.12, "ankle": np.inf, "foot": np.inf,
}  # fmt: skip
"""Metres in front of a joint within which the parts that meet there do not occlude it; inf: they
never do. Fitted to the renderer's visibility on simulated footage."""
_PARTS: dict[str, tuple[str, ...]] = {
    "head": ("head", "neck"),
    "neck": ("head", "neck", "chest", "left_shoulder", "right_shoulder"),
    "shoulder": ("shoulder", "upper_arm", "chest"),
    "elbow": ("upper_arm", "forearm"),
    "wrist": ("forearm", "hand"),
    "hand": ("forearm", "hand"),
    "hip": ("pelvis", "thigh"),
    "knee": ("thigh", "shank"),
    "ankle": ("shank", "foot"),
    "foot": ("shank", "foot"),
}
"""Parts that meet at each label; those of limbs on the label's own side."""


def joints_seen(
    angles: Float[Array, "B 37"],
    joints_head: Float[Array, "B 18 3"],
    body: GaussianBody,
    rig: Rig,
    depth: float = DEPTH,
) -> Bool[Array, "B V 18"]:
    """Whether each joint is visible in each view: inside lens and image, and not occluded."""
    _, in_view = rig.project(joints_head)  # (V, B, 18)
    passed = optical_depths(angles, joints_head, body, rig) < depth
    return np.moveaxis(in_view, 0, 1) & passed


def optical_depths(
    angles: Float[Array, "B 37"],
    joints_head: Float[Array, "B 18 3"],
    body: GaussianBody,
    rig: Rig,
) -> Float[Array, "B V 18"]:
    """Optical depth of the other parts between every view and every joint."""
    centres = gaussian_centres(angles, body)
    eyes = np.ascontiguousarray(rig.T_head_camera[:, :3, 3])
    strength = body.density * body.sigma * np.sqrt(2.0 * np.pi)
    out = np.empty((len(angles), len(eyes), len(LABELS)))
    joints = np.ascontiguousarray(joints_head, float)
    margins = np.array([MARGINS[label.rpartition("_")[2]] for label in LABELS])
    _depths(centres, body.sigma, strength, foreign_parts(body), margins, eyes, joints, out)
    return out


def foreign_parts(body: GaussianBody) -> Bool[Array, "18 G"]:
    """Whether a Gaussian belongs to none of the parts that meet at a label."""
    foreign = np.ones((len(LABELS), len(body.parts)), bool)
    for row, label in zip(foreign, LABELS, strict=True):
        side, _, kind = label.rpartition("_")
        near = {part for name in _PARTS[kind] for part in (name, f"{side}_{name}")}
        row[:] = [part not in near for part in body.parts]
    return foreign


@njit(cache=True, parallel=True)
def _depths(centres, sigma, strength, foreign, margins, eyes, joints, out):
    for t in prange(len(joints)):
        for v in range(len(eyes)):
            for label in range(joints.shape[1]):
                ray = joints[t, label] - eyes[v]
                length = np.sqrt((ray * ray).sum())
                ray = ray / length
                total = 0.0
                for q in range(len(sigma)):
                    end = length if foreign[label, q] else length - margins[label]
                    arm = centres[t, q] - eyes[v]
                    middle = (arm * ray).sum()
                    across = (arm * arm).sum() - middle * middle
                    s = sigma[q]
                    if across > 16.0 * s * s:
                        continue
                    if end <= 0.0:
                        continue
                    share = 0.5 * (
                        _erf((end - middle) / (1.41421356 * s)) - _erf(-middle / (1.41421356 * s))
                    )
                    total += strength[q] * np.exp(-0.5 * across / (s * s)) * share
                out[t, v, label] = total


@njit(cache=True)
def _erf(x):
    """Error function to 1.5e-7.  Source: Abramowitz & Stegun, 7.1.26."""
    a = abs(x)
    t = 1.0 / (1.0 + 0.3275911 * a)
    series = 0.254829592 + t * (
        -0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))
    )
    y = 1.0 - t * series * np.exp(-a * a)
    return y if x >= 0.0 else -y
