"""Joint angles of canonical clips, their limits, and limbs that bend backwards.

The angles and limits are those of the tracker's skeleton (`egocap.body.skeleton`, with sources):
canonical body frames are the identity in its rest pose, so a body's rotation relative to its parent
is the product of the twists of one of its joints. Head and trunk are rooted the other way round.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.skeleton import JOINTS, Joint
from egocap.geometry import axis_angle, unit
from egocap_sim.core.bodies import INDEX
from egocap_sim.motion.clips.cleaning import (
    interpolate_bodies,
    to_local,
    with_local_rotations,
)
from egocap_sim.motion.kinematics.clip import Clip

TOLERANCE = np.deg2rad(20.0)  # beyond the limits, for people and calibrations that differ
FLEXED = np.deg2rad(30.0)  # from here on the plane of an elbow or knee is defined
FEW = 10  # flexed frames that a judgement of a hinge needs
LOCKED = np.deg2rad(75.0)  # of the middle angle: the outer two are not defined beyond
NECK_LEAN = np.deg2rad(75.0)  # of the neck's bone from the line pelvis to neck; clips reach 56

_BY_NAME = {joint.name: joint for joint in JOINTS}
_BETWEEN: dict[str, tuple[str, str]] = {
    "neck": ("head", "chest"), "lower_spine": ("chest", "pelvis"),
}  # fmt: skip
for _side in ("left", "right"):
    _BETWEEN |= {
        f"{_side}_{joint}": (f"{_side[0]}_{parent}", f"{_side[0]}_{body}")
        for joint, parent, body in (
            ("shoulder", "clavicle", "upperarm"), ("elbow", "upperarm", "forearm"),
            ("wrist", "forearm", "hand"), ("knee", "thigh", "calf"), ("ankle", "calf", "foot"),
        )
    }  # fmt: skip
    _BETWEEN[f"{_side}_hip"] = "pelvis", f"{_side[0]}_thigh"

_HINGES = ("left_elbow", "right_elbow", "left_knee", "right_knee")
_ROTATION = {"elbow": "shoulder_rotation", "knee": "hip_rotation"}


def joint_angles(clip: Clip) -> dict[str, Float[Array, "T"]]:
    """Angles of a canonical clip by the names of the tracker's, radians; nan where undefined."""
    R = clip.rotations
    angles = {}
    for joint, (parent, body) in _BETWEEN.items():
        local = np.swapaxes(R[:, INDEX[parent]], 1, 2) @ R[:, INDEX[body]]
        angles |= _angles(local, _BY_NAME[joint])
    return angles


def beyond_limits(clip: Clip) -> dict[str, Float[Array, "T"]]:
    """How far each angle is beyond its limit and the tolerance, radians; 0 within."""
    found = {}
    limits = {dof.name: dof for joint in JOINTS for dof in joint.dofs}
    for name, angle in joint_angles(clip).items():
        low, high = np.deg2rad((limits[name].lower_deg, limits[name].upper_deg))
        excess = np.maximum(low - angle, angle - high) - TOLERANCE
        found[name] = np.maximum(np.nan_to_num(excess), 0.0)
    return found


def neck_lean(clip: Clip) -> Float[Array, "T"]:
    """Angle of the line from neck to head off the line from pelvis to neck, radians."""
    p = clip.positions
    trunk = unit(p[:, INDEX["neck"]] - p[:, INDEX["pelvis"]])
    neck = unit(p[:, INDEX["head"]] - p[:, INDEX["neck"]])
    return np.arccos(np.clip((trunk * neck).sum(1), -1.0, 1.0))


def reversed_hinges(clip: Clip) -> dict[str, float]:
    """Elbows and knees that bend backwards in most flexed frames, and the share of those.

    Calibration takes the plane of flexion for the hinge's, so a limb that bends backwards seems
    turned by 180 degrees about its upper bone.
    """
    angles, found = joint_angles(clip), {}
    for hinge in _HINGES:
        side, _, part = hinge.partition("_")
        flexed = np.abs(angles[f"{hinge}_flexion"]) > FLEXED
        turned = angles[f"{side}_{_ROTATION[part]}"][flexed]
        known = turned[np.isfinite(turned)]
        if len(known) < FEW:
            continue
        share = float((np.abs(known) > np.deg2rad(115.0)).mean())
        if share > 0.5:
            found[hinge] = share
    return found


def straighten(clip: Clip, hinge: str) -> Clip:
    """Bend an elbow or knee that bends backwards by the same angle the other way.

    The result has to be calibrated again, since the limb's frames are those of the reversed hinge.
    """
    body = INDEX[_BETWEEN[hinge][1]]
    flexion = joint_angles(clip)[f"{hinge}_flexion"]
    local = to_local(clip.rotations)
    axis = np.array(_BY_NAME[hinge].dofs[0].axis)
    local[:, body] = axis_angle(axis, -np.abs(flexion) - flexion) @ local[:, body]
    return replace(with_local_rotations(clip, local), canonical=False)


def raise_head(clip: Clip) -> Clip:
    """Interpolate neck and head where the head is beyond the neck's limits relative to the chest.

    The frames around, in which it is beyond half of a limit, are interpolated with them. Where that
    is most of the clip, neck and head are fixed to the chest.
    """
    from scipy.ndimage import binary_propagation

    beyond, angles = beyond_limits(clip), joint_angles(clip)
    dofs = _BY_NAME["neck"].dofs
    seeds = np.any([beyond[dof.name] > 0.0 for dof in dofs], axis=0)
    if not seeds.any():
        return clip
    tilted = np.any(
        [np.abs(angles[dof.name]) > 0.5 * np.deg2rad(dof.upper_deg) for dof in dofs], axis=0
    )
    bad = np.asarray(binary_propagation(seeds, mask=tilted | seeds), bool)
    return interpolate_bodies(clip, ("neck", "head"), bad)


def _angles(local: Float[Array, "T 3 3"], joint: Joint) -> dict[str, Float[Array, "T"]]:
    """Twist angles whose product is a rotation; of an ankle only the flexion."""
    from scipy.spatial.transform import Rotation

    axes = [unit(np.array(dof.axis, float)) for dof in joint.dofs]
    axes = [axis for i, axis in enumerate(axes) if not i or abs(axis @ axes[0]) < 1e-6]
    first = axes[0]
    second = axes[1] if len(axes) > 1 else unit(np.cross((0, 0, 1), first))
    third = np.cross(first, second)
    B = np.stack([first, second, third])
    turns = Rotation.from_matrix(B @ local @ B.T).as_euler("XYZ")
    if len(axes) > 2:
        turns[:, 2] *= np.sign(third @ axes[2])
    turns[np.abs(turns[:, 1]) > LOCKED] *= [np.nan, 1.0, np.nan]
    return {
        dof.name: _around(turns[:, i], np.deg2rad(0.5 * (dof.lower_deg + dof.upper_deg)))
        for i, dof in enumerate(joint.dofs[: len(axes)])
    }


def _around(angle: Float[Array, "T"], centre: float) -> Float[Array, "T"]:
    """The angles within half a turn of a centre."""
    return (angle - centre + np.pi) % (2 * np.pi) - np.pi + centre
