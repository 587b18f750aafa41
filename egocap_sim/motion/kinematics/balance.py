"""Keep the centre of mass of a standing figure over its feet, by shifting the pelvis.

Source: segment masses and centres after D. Winter, Biomechanics and Motor Control of Human
Movement, table 4.1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.posing import Controls

_SEGMENTS = [("pelvis", "spine", 0.142), ("spine", "chest", 0.139), ("chest", "neck", 0.216)]
for _s in ("l_", "r_"):
    _SEGMENTS += [
        (_s + "upperarm", _s + "forearm", 0.028), (_s + "forearm", _s + "hand", 0.022),
        (_s + "thigh", _s + "calf", 0.100), (_s + "calf", _s + "foot", 0.0465),
        (_s + "foot", _s + "toe", 0.0145),
    ]  # fmt: skip
_HEAD, _HEAD_UP = 0.081, 0.08  # its mass, and metres from the skull base to its centre
_SHARES = np.zeros(len(BODIES))  # of the mass, lumped at the joints
_SHARES[INDEX["head"]] = _HEAD
for _a, _b, _m in _SEGMENTS:
    _SHARES[INDEX[_a]] += 0.55 * _m
    _SHARES[INDEX[_b]] += 0.45 * _m

OVER = 0.035  # metres before the ankles: centre of mass while standing
SLACK = 0.025  # metres of deviation that are not corrected
SMOOTH = 0.12  # seconds, standard deviation of the smoothing of the shift


def centre_of_mass(clip: Clip) -> Float[Array, "T 3"]:
    """Whole-body centre of mass of a canonical clip, world, metres."""
    head = _HEAD * _HEAD_UP * clip.rotations[:, INDEX["head"], :, 2]
    return (_SHARES @ clip.positions + head) / _SHARES.sum()


def balance_pose(
    controls: Controls,
    pose: Callable[[Controls], Clip],
    support: Float[Array, "T 2"] | None = None,
) -> Clip:
    """Pose the controls with the pelvis shifted so that the centre of mass stays above the feet,
    or above the ground points `support`."""
    from scipy.ndimage import gaussian_filter1d

    clip = pose(controls)
    ahead = controls.foot_R[:, :, :2, 0].mean(1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    target = controls.ankle[:, :, :2].mean(1) + OVER * ahead if support is None else support
    for _ in range(3):
        off = centre_of_mass(clip)[:, :2] - target
        far = np.linalg.norm(off, axis=1, keepdims=True)
        shift = -off * np.maximum(0.0, 1.0 - SLACK / np.maximum(far, 1e-9))
        shift = gaussian_filter1d(shift, SMOOTH * clip.fps, axis=0, mode="nearest")
        pelvis = controls.pelvis + np.pad(shift, ((0, 0), (0, 1)))
        controls = dataclasses.replace(controls, pelvis=pelvis)
        clip = pose(controls)
    return clip
