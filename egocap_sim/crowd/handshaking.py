"""Handshakes with the wearer: when and where the hand is extended, and the partner's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d

from egocap.geometry import UP, axis_angle, rigid, transform
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.person import Person
from egocap_sim.motion.generators.keyframes import DOWN, Keyframes
from egocap_sim.motion.generators.stance import draw_style
from egocap_sim.motion.generators.tasks import OFFERED, RIGHT
from egocap_sim.motion.kinematics.clip import Clip
from egocap_sim.motion.kinematics.curves import minimum_jerk
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.kinematics.limbs import bend_limb
from egocap_sim.motion.retarget.palms import find_palm

Bodies = Float[Array, "T 21 4 4"]
_OUT_M = (0.26, 0.40)  # distance of the palm ahead of the shoulder at which the reach is 0 and 1
_STILL_M = 0.20  # largest movement of the extended hand that a standing partner can follow
_NEARER = 0.88  # partner's over the wearer's distance from the hands, as the wearer leans forward
_LEAD_S = 0.55  # time by which the partner's hand starts before the wearer's is extended


@dataclass(frozen=True, eq=False)
class Handshake:
    """The wearer's extended hand: how far it reaches in each frame (0 to 1), and its palm."""

    share: Float[Array, "T"]
    palm: Float[Array, "T 3"]
    stands: Float[Array, "2"]  # position of the wearer while the hand is extended
    place: Float[Array, "2"]  # horizontal position of the hand
    arm: float  # length of the wearer's arm (m)


def find_handshake(wearer: Person, bodies: Bodies) -> Handshake | None:
    """Detect when and where the wearer extends the right hand; None unless it is held still."""
    palm = find_palm(wearer, "r")
    at = transform(bodies[:, palm.body], palm.centre[None])[:, 0]
    chest, shoulder = bodies[:, INDEX["chest"]], bodies[:, INDEX["r_upperarm"], :3, 3]
    ahead = chest[:, :3, 0] * [1.0, 1.0, 0.0]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = ((at - shoulder) * ahead).sum(1)
    level = np.abs(at[:, 2] - shoulder[:, 2] + 0.33) < 0.2
    share = minimum_jerk((out - _OUT_M[0]) / (_OUT_M[1] - _OUT_M[0])) * level
    held = share > 0.95
    if held.sum() < 5 or np.linalg.norm(at[held] - at[held].mean(0), axis=1).max() > _STILL_M:
        return None
    stands, place = bodies[held, 0, :2, 3].mean(0), at[held].mean(0)[:2]
    return Handshake(share, at, stands, place, _arm(wearer))


def partner_pose(handshake: Handshake, person: Person) -> Float[Array, "4 4"]:
    """World pose opposite the wearer, with the hand between them, of a motion along +x."""
    away = handshake.place - handshake.stands
    reach = _arm(person) / handshake.arm
    at = handshake.place + _NEARER * min(max(reach, 0.8), 1.1) * away
    # Both right hands lie beside the line between the bodies, so the partner is turned by `side`.
    x, y, _ = OFFERED.wrist
    side = np.arctan2((0.19 + y) / (x + 0.09), 1.0)  # the shoulder is 0.19 m to the right
    yaw = np.arctan2(-away[1], -away[0]) - side
    return rigid(axis_angle(UP, float(yaw)), np.array([*at, 0.0]))


def handshake_clip(
    handshake: Handshake, times: Float[Array, "T"], rng: np.random.Generator, fps: float
) -> Clip:
    """The partner's motion: the hand is extended while the wearer's is."""
    keys = Keyframes(draw_style(rng), rng)
    keys.gaze(0.0, 0.05)
    out = handshake.share > 0.5
    edges = np.flatnonzero(np.diff(np.concatenate([[0], out.astype(int), [0]]))).reshape(-1, 2)
    for first, end in edges:
        start, stop = times[first] - times[0], times[min(end, len(times) - 1)] - times[0]
        keys.clock = max(keys.clock, start - _LEAD_S)
        keys.hand(RIGHT, OFFERED, max(0.3, start + 0.15 - keys.clock))
        keys.clock = max(stop - 0.1, keys.clock + 0.35)
        keys.clock = keys.hand(RIGHT, DOWN, 0.8)
    t = np.arange(round((float(times[-1] - times[0]) + 0.5) * fps) + 1) / fps
    return keys.clip("handshake_clip", t, fps)


def reach_palm(handshake: Handshake, person: Person, bodies: Bodies, fps: float) -> Bodies:
    """Bend the partner's right arm so that the palms meet while the hand is extended."""
    palm = find_palm(person, "r")
    at = transform(bodies[:, palm.body], palm.centre[None])[:, 0]
    smooth = gaussian_filter1d(handshake.share, 0.06 * fps, mode="nearest")
    R = bend_limb(
        bodies[..., :3, 3],
        bodies[..., :3, :3],
        "r",
        smooth[:, None] * (handshake.palm - at),
        arm=True,
    )
    return rigid(R, joint_positions(person.joints, bodies[:, 0, :3, 3], R))


def _arm(person: Person) -> float:
    chain = person.joints[[INDEX["r_upperarm"], INDEX["r_forearm"], INDEX["r_hand"]]]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())
