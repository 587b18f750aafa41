"""Retarget a clip to a person: a reference motion on the person's bones and floor.

A canonical clip has rotations relative to standing upright with hanging arms, palms at the thighs
and feet forward. The person's rest pose differs (arms low, feet slightly turned out), so each body
has a constant offset from its rest pose to the canonical one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d

from egocap.errors import InputError
from egocap.geometry import (
    LEFT,
    UP,
    axis_angle,
    matrix_to_quaternion,
    quaternion_to_matrix,
    rigid,
    unit,
)  # fmt: skip
from egocap.series import interpolate
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.core.ground_boxes import GroundBox
from egocap_sim.core.pose_sampling import slerp
from egocap_sim.human.body.person import Person
from egocap_sim.human.body.soles import foot_yaw
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import continuous
from egocap_sim.motion.kinematics.figure import joint_positions, leg_length
from egocap_sim.motion.kinematics.limbs import shortest_arc
from egocap_sim.motion.retarget.foot_planting import plant

_SHORTEST_S = 0.2
_SMOOTH_S = 0.02  # standard deviation of the smoothing, seconds
_NEXT = {"upperarm": "forearm", "forearm": "hand", "thigh": "calf", "calf": "foot"}


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion for a person: pelvis positions and world rotations of all bodies.

    `rotations` turn each body's rest orientation (parallel to the world) into its posed one.
    """

    fps: float
    root: Float[Array, "T 3"]  # metres, world
    rotations: Float[Array, "T 21 3 3"]
    planted: Bool[Array, "T 4"]  # standing feet, in the order of egocap_sim.core.bodies.FEET
    touching: Bool[Array, "T 4"]  # feet at floor height, standing or sliding
    ground_boxes: tuple[GroundBox, ...] = ()  # supports besides the floor

    @property
    def duration_s(self) -> float:
        """Seconds from the first pose to the last."""
        return (len(self.root) - 1) / self.fps


def retarget(
    clip: Clip,
    person: Person,
    fps: float = 50.0,
    *,
    from_origin: bool = True,
    grounded: bool = True,
) -> Reference:
    """Retarget a canonical clip to a person: pose, stride, floor height and planted feet.

    With `from_origin` the motion starts above the origin, facing +x; otherwise at the clip's start.
    Without `grounded` the motion is not aligned to the floor and has no standing feet.
    Raises InputError for a clip that is not canonical, not finite, or shorter than 0.2 s.
    """
    _check(clip, fps)
    turned = clip.rotations @ canonical_offsets(person)
    root = _root(clip, person, turned[:, 0])
    if from_origin:
        root, turned = _to_origin(root, turned, clip.rotations[0])
    root, turned = _resample(root, turned, clip.fps, fps)
    if not grounded:
        nowhere = np.zeros((len(root), 4), bool)
        return Reference(float(fps), root, turned, nowhere, nowhere)
    root, turned, planted, touching = plant(person, root, turned, fps)
    return Reference(float(fps), root, turned, planted, touching)


def canonical_offsets(person: Person) -> Float[Array, "21 3 3"]:
    """Rotations that bring each body of the person from its rest to the canonical pose.

    Raises InputError where a limb of the person has no length.
    """
    offsets = np.tile(np.eye(3), (len(BODIES), 1, 1))
    for side in ("l", "r"):
        for part in ("thigh", "calf"):
            offsets[INDEX[f"{side}_{part}"]] = shortest_arc(_bone(person, side, part), -UP)
        flat = axis_angle(UP, -foot_yaw(person, side))
        offsets[INDEX[f"{side}_foot"]] = offsets[INDEX[f"{side}_toe"]] = flat
        # A rest elbow is bent, so its hinge is known; the palm faces along the same axis.
        hinge = np.cross(_bone(person, side, "upperarm"), _bone(person, side, "forearm"))
        if np.linalg.norm(hinge) < np.sin(np.deg2rad(3)):
            hinge = -LEFT
        for part in ("upperarm", "forearm", "hand"):
            rest = _frame(_bone(person, side, part), hinge)
            offsets[INDEX[f"{side}_{part}"]] = _frame(-UP, -LEFT) @ rest.T
    return offsets


def _check(clip: Clip, fps: float) -> None:
    """Raise InputError for invalid clips and rates."""
    if not clip.canonical:
        raise InputError(
            f"motion '{clip.name}' is not in canonical body frames",
            valid="a clip of egocap_sim.motion.load_clip or make_motion",
        )
    if not (np.isfinite(clip.positions).all() and np.isfinite(clip.rotations).all()):
        raise InputError(f"motion '{clip.name}' has values that are not finite numbers")
    if not clip.fps > 0 or (len(clip.positions) - 1) / clip.fps < _SHORTEST_S:
        raise InputError(
            f"motion '{clip.name}' has {len(clip.positions)} frames at {clip.fps:g} per second",
            valid=f"at least {_SHORTEST_S:g} s",
        )
    if not 10 <= fps <= 500:
        raise InputError(f"cannot retarget to {fps:g} frames per second", valid="10 to 500")


def _bone(person: Person, side: str, part: str) -> Float[Array, "3"]:
    """Unit direction of a limb's bone at rest, from its joint to the next."""
    start = person.joints[INDEX[f"{side}_{part}"]]
    if part == "hand":
        bone = person.landmarks["left_hand" if side == "l" else "right_hand"]
    else:
        bone = person.joints[INDEX[f"{side}_{_NEXT[part]}"]] - start
    if np.linalg.norm(bone) < 0.01:
        raise InputError(f"person '{person.name}' has no {side}_{part}", valid="bones over 1 cm")
    return unit(bone)


def _frame(direction: Float[Array, "3"], hinge: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Orthonormal columns: a direction, the hinge made normal to it, their cross product."""
    d = unit(direction)
    h = unit(hinge - (hinge @ d) * d)
    return np.stack([d, h, np.cross(d, h)], -1)


def _hips(positions: Float[Array, "*batch 21 3"]) -> Float[Array, "*batch 3"]:
    """Middle of the hip joints, which unlike the pelvis joint is comparable between skeletons."""
    return (positions[..., INDEX["l_thigh"], :] + positions[..., INDEX["r_thigh"], :]) / 2


def _root(clip: Clip, person: Person, pelvis: Float[Array, "T 3 3"]) -> Float[Array, "T 3"]:
    """Pelvis positions: the clip's hips scaled by leg length, less the person's own offset."""
    length = leg_length(clip.positions)
    if length < 0.05:
        raise InputError(f"motion '{clip.name}' has legs of {length:.3f} m", valid="over 0.05 m")
    scale = leg_length(person.joints) / length
    return scale * _hips(clip.positions) - pelvis @ (_hips(person.joints) - person.joints[0])


def _to_origin(
    root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], first: Float[Array, "21 3 3"]
) -> tuple[Float[Array, "T 3"], Float[Array, "T 21 3 3"]]:
    """Turn the motion about z to start facing +x and move it to start above the origin."""
    facing = first[INDEX["pelvis"], :, 0] + first[INDEX["chest"], :, 0]
    R = axis_angle(UP, -np.arctan2(facing[1], facing[0]))
    start = root[0] * [1, 1, 0]
    return (root - start) @ R.T, R @ turned


def _resample(
    root: Float[Array, "T 3"], turned: Float[Array, "T 21 3 3"], source_fps: float, fps: float
) -> tuple[Float[Array, "U 3"], Float[Array, "U 21 3 3"]]:
    """Sample at another rate (slerp) and smooth lightly; the speed at the ends is kept."""
    keys = np.arange(len(root)) / source_fps
    times = np.arange(int(keys[-1] * fps + 1e-6) + 1) / fps
    times = np.minimum(times, keys[-1])
    positions = interpolate(times, keys, root)
    place = times * source_fps
    first = np.minimum(place.astype(int), len(root) - 2)
    q = matrix_to_quaternion(turned)
    q = continuous(slerp(q[first], q[first + 1], (place - first)[:, None]))
    return _smooth(positions, _SMOOTH_S * fps), quaternion_to_matrix(_smooth(q, _SMOOTH_S * fps))


def _smooth(values: Float[Array, "T *n"], sigma: float) -> Float[Array, "T *n"]:
    """Gaussian smoothing; beyond its ends the motion goes on as its point reflection."""
    more = min(int(4 * sigma + 1), len(values) - 1)
    ends = [(more, more)] + [(0, 0)] * (values.ndim - 1)
    longer = np.pad(values, ends, mode="reflect", reflect_type="odd")
    return gaussian_filter1d(longer, sigma, axis=0, mode="nearest")[more : more + len(values)]


def sample_reference(
    person: Person, reference: Reference, times: Float[Array, "T"]
) -> Float[Array, "T 21 4 4"]:
    """World body frames of a reference played without forces, at times in seconds.

    The pose is constant before the start and after the end. Root and rotations are interpolated
    between the same keys, so that standing feet do not slide.
    """
    last = len(reference.root) - 1
    at = np.clip(np.asarray(times, float) * reference.fps, 0.0, last)
    k = np.minimum(at.astype(int), last - 1)
    s = at - k
    q = continuous(matrix_to_quaternion(reference.rotations))
    between = (1 - s)[:, None, None] * q[k] + s[:, None, None] * q[k + 1]
    rotations = quaternion_to_matrix(between / np.linalg.norm(between, axis=-1, keepdims=True))
    root = (1 - s)[:, None] * reference.root[k] + s[:, None] * reference.root[k + 1]
    return rigid(rotations, joint_positions(person.joints, root, rotations))
