"""Estimate the constant rotation from a rig's bone frames to the simulation's body frames.

A source bone frame is arbitrary: two tools store the same pose with different matrices, and the
zero pose of many files (LAFAN1, CC_Base) is no human pose. The calibration therefore uses anatomy.
For every body it estimates two canonical axes in the source bone's frame:

- pelvis: left is the line through the hips, up the mean world up while the person stands;
- spine, chest: left is the line through the shoulders (the mean facing for the spine), up the line
  from pelvis to neck, so that a stoop is preserved;
- head: the robust mean orientation while standing, relative to the facing of hips and shoulders, so
  that the head is level on average; its left is the line through the eyes where the rig has them.
  The neck is halfway between chest and head;
- upper arm, forearm, thigh, calf: down is the bone; left is the hinge of the elbow or knee, from
  the plane of the flexed limb. If the joint hardly bends, the limb swings without twist;
- foot: up is the world's up while the foot is low and slow; forward is towards the toes;
- toe: as the foot while that is flat; hand: from the fingers where the rig has them, otherwise the
  mean of the forearm, slightly pronated; clavicle: as the chest while the arm hangs.

The canonical pose, all rotations the identity: standing upright facing +x, arms straight down with
the palms at the thighs, feet flat and pointing forward.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.errors import InputError
from egocap.geometry import LEFT, UP, axis_angle, unit
from egocap_sim.core.bodies import BODIES, INDEX
from egocap_sim.motion.kinematics.clip import Clip

Hints = Mapping[str, Mapping[str, Array]]
"""Known axes of a bone, in its own frame: body -> 'forward' | 'left' | 'up' -> (3,) vector."""

MIN_FLEXION = 0.25  # sine of the smallest elbow or knee angle that defines a plane (15 degrees)
HINGE_PRIOR = 0.05  # weight of a limb without twist, in frames of full flexion per frame
SOLE_SLOPE = (0.1, 0.75)  # radians the line ankle to toe descends, plausible for a flat foot
TYPICAL_SLOPE = 0.42
TYPICAL_PRONATION = 0.26  # radians, of a hand on average (measured on 47 clips with fingers)


def calibrate(clip: Clip, hints: Hints | None = None) -> Clip:
    """The same motion with canonical rotations (`Clip.canonical`); positions are unchanged.

    Raises InputError as `bone_frames`.
    """
    return canonical(clip, bone_frames(clip, hints))


def canonical(clip: Clip, K: Float[Array, "21 3 3"]) -> Clip:
    """The clip with canonical rotations, given the bone frames; unchanged if it has them."""
    if clip.canonical:
        return clip
    return dataclasses.replace(clip, rotations=clip.rotations @ K, canonical=True)


def bone_frames(clip: Clip, hints: Hints | None = None) -> Float[Array, "21 3 3"]:
    """Canonical axes (columns forward, left, up) of every body in its source bone's frame.

    Raises InputError where left and right are exchanged (the knees would bend forward), and for
    bones without length, whose direction is undefined.
    """
    if clip.canonical:
        return np.broadcast_to(np.eye(3), (len(BODIES), 3, 3))
    K = _Calibration(clip, hints or {}).run()
    undefined = [BODIES[b] for b in np.flatnonzero(~(np.linalg.det(K) > 0.5))]
    if undefined:
        raise InputError(f"no direction of {', '.join(undefined)}: a bone there has no length")
    return K


class _Calibration:
    def __init__(self, clip: Clip, hints: Hints) -> None:
        self.P, self.R, self.fps, self.hints = clip.positions, clip.rotations, clip.fps, hints
        self.name, self.T = clip.name, len(clip.positions)
        self.K = np.zeros((len(BODIES), 3, 3))

    def run(self) -> Float[Array, "21 3 3"]:
        self._stance()
        self._trunk()
        for side in ("l_", "r_"):
            self._limb(side + "thigh", side + "calf", side + "foot", "pelvis", sign=1.0)
        self._check_knees()
        for side in ("l_", "r_"):
            self._foot(side)
            self._clavicle(side)
            self._limb(side + "upperarm", side + "forearm", side + "hand", "chest", sign=-1.0)
            self._hand(side)
        return self.K

    def to(self, a: str, b: str) -> Float[Array, "T 3"]:
        """World vectors from the joint of body a to that of body b."""
        return self.P[:, INDEX[b]] - self.P[:, INDEX[a]]

    def local(self, body: str, v: Float[Array, "*T 3"]) -> Float[Array, "T 3"]:
        """World vectors in a body's source bone frame."""
        return np.einsum("tji,tj->ti", self.R[:, INDEX[body]], np.broadcast_to(v, (self.T, 3)))

    def mean(self, body: str, v: Array, w: Array | None = None) -> Float[Array, "3"]:
        """Weighted mean of world vectors in a body's bone frame."""
        return np.average(self.local(body, v), axis=0, weights=w)

    def canonical(self, body: str) -> Float[Array, "T 3 3"]:
        return self.R[:, INDEX[body]] @ self.K[INDEX[body]]

    def _stance(self) -> None:
        """Weight of each frame as standing, and the facing frame of the body."""
        from scipy.ndimage import gaussian_filter1d

        self.trunk = unit(self.to("pelvis", "neck"))
        trunk = self.trunk[:, 2]
        legs = -0.5 * (unit(self.to("l_thigh", "l_calf")) + unit(self.to("r_thigh", "r_calf")))
        self.stand = _ramp(trunk, 0.85, 0.97) * _ramp(legs[:, 2], 0.7, 0.9)
        if self.stand.sum() < min(10, 0.2 * self.T):
            self.stand = _ramp(trunk, 0.7, 0.97)
        left = unit(self.to("r_thigh", "l_thigh")) + unit(self.to("r_upperarm", "l_upperarm"))
        self.up = np.broadcast_to(UP, (self.T, 3))
        if self.stand.sum() < min(5, 0.1 * self.T):  # never upright: use the axis of the trunk
            self.stand, self.up = np.ones(self.T), self.trunk
        self.facing = _frames(left, self.up)
        if self.T > 1:  # a turning person looks into the turn: lower weight
            heading = np.unwrap(np.arctan2(self.facing[:, 1, 0], self.facing[:, 0, 0]))
            rate = gaussian_filter1d(np.gradient(heading) * self.fps, 0.3 * self.fps)
            self.stand = self.stand * (np.exp(-((rate / 0.5) ** 2)) + 0.01)

    def _trunk(self) -> None:
        roots = np.linalg.norm(self.to("r_clavicle", "l_clavicle"), axis=1).mean()
        shoulders = "clavicle" if roots > 0.01 else "upperarm"
        lines = {
            "pelvis": self.to("r_thigh", "l_thigh"),
            "chest": self.to("r_" + shoulders, "l_" + shoulders),
        }
        leaning = _frames(self.facing[:, :, 1], self.trunk)
        for body in ("pelvis", "spine", "chest", "head", "neck"):
            frames = leaning if body in ("spine", "chest") else self.facing
            if body == "neck":  # between chest and head, also in a stoop
                up = unit(self.canonical("chest")[:, :, 2] + self.canonical("head")[:, :, 2])
                frames = _frames(self.facing[:, :, 1], up)
            K = self._mean_frame(body, frames, self.stand)
            left = self.hints.get(body, {}).get("left")
            if body in lines:
                left = self.mean(body, lines[body], self.stand)
            if left is not None:
                K = _frame(left, K[:, 2])
            self.K[INDEX[body]] = K

    def _mean_frame(
        self, body: str, frames: Float[Array, "T 3 3"], w: Float[Array, "T"]
    ) -> Float[Array, "3 3"]:
        """Robust mean of frames in a bone's frame; outliers are down-weighted."""
        seen = np.swapaxes(self.R[:, INDEX[body]], 1, 2) @ frames
        robust = w
        for _ in range(4):
            K = _nearest_rotation(np.average(seen, axis=0, weights=robust))
            angle = _angle(np.swapaxes(seen, 1, 2) @ K)
            robust = w * np.exp(-((angle / 0.35) ** 2)) + 1e-9 * w
        return K

    def _limb(self, upper: str, lower: str, end: str, root: str, sign: float) -> None:
        """Hinged limb; `sign`: the flexion axis is +left for the knee, -left for the elbow."""
        u, v = self.to(upper, lower), self.to(lower, end)
        hinge = np.cross(unit(u), unit(v)) * sign
        bend = np.linalg.norm(hinge, axis=1)
        weight = np.where(bend > MIN_FLEXION, bend, 0.0)
        evidence = (self.local(upper, hinge) * weight[:, None]).mean(0)
        left = evidence + HINGE_PRIOR * self._untwisted_left(upper, u, root)
        self.K[INDEX[upper]] = _frame_down(self.mean(upper, u), left)
        left = self.mean(lower, self.canonical(upper)[:, :, 1])
        self.K[INDEX[lower]] = _frame_down(self.mean(lower, v), left)

    def _untwisted_left(self, body: str, bone: Float[Array, "T 3"], root: str) -> Float[Array, "3"]:
        """Left axis after the shortest rotation of the bone from straight down."""
        C = self.canonical(root)
        d = np.einsum("tji,tj->ti", C, unit(bone))
        swung = np.einsum("tij,tj->ti", C, _swing_of_left(d))
        return self.mean(body, swung, np.maximum(-d[:, 2], 0.0) + 0.02)

    def _check_knees(self) -> None:
        """Raise InputError if both knees flex forwards."""
        against = []
        for side in ("l_", "r_"):
            u, v = self.to(side + "thigh", side + "calf"), self.to(side + "calf", side + "foot")
            hinge = np.cross(unit(u), unit(v))
            bent = np.linalg.norm(hinge, axis=1) > 0.4
            lateral = (hinge * unit(self.to("r_thigh", "l_thigh"))).sum(1)[bent]
            against.append(bent.mean() > 0.1 and np.mean(lateral < -0.2) > 0.8)
        if all(against):
            raise InputError(
                f"{self.name}: the knees bend forward, so left and right are exchanged or the "
                "motion is mirrored",
                valid="a name map that gives the person's own left and right",
            )

    def _foot(self, side: str) -> None:
        foot, toe, calf = side + "foot", side + "toe", side + "calf"
        bone = self.mean(foot, self.to(foot, toe))
        if np.linalg.norm(bone) < 1e-3:  # no toe: use the facing of the shank while standing
            forward = self.mean(foot, self.canonical(calf)[:, :, 0], self.stand)
            self.K[INDEX[foot]] = _frame_forward(forward, self.mean(foot, self.up, self.stand))
        else:
            self.K[INDEX[foot]] = self._sole(foot, toe, bone)
        flat = _ramp(self.canonical(foot)[:, 2, 2], 0.9, 0.99) + 1e-6
        self.K[INDEX[toe]] = self._mean_frame(toe, self.canonical(foot), flat)

    def _sole(self, foot: str, toe: str, bone: Float[Array, "3"]) -> Float[Array, "3 3"]:
        """Axes of a foot, from the slope of its bone (ankle to toe) while it stands flat.

        The roll about the bone comes from the world's up in those frames, with the knee as prior.
        """
        w = self._planted(foot, toe)
        slope = np.arcsin(np.clip(-unit(self.to(foot, toe))[:, 2], -1.0, 1.0))
        w = np.where((slope > SOLE_SLOPE[0]) & (slope < SOLE_SLOPE[1]), w, 0.0)
        flat, angle = np.zeros(self.T), TYPICAL_SLOPE
        if w.sum() > 3.0:
            angle = _mode(slope, w, width=0.06)
            flat = w * np.exp(-(((slope - angle) / 0.1) ** 2))
        left = self.mean(foot, self.canonical(foot[:2] + "calf")[:, :, 1])
        up = (self.local(foot, UP) * flat[:, None]).sum(0) + 0.02 * self.T * np.cross(
            unit(bone), unit(left)
        )
        lying = _frame_forward(bone, up)  # x along the bone: pitch it up by the slope
        c, s = np.cos(angle), np.sin(angle)
        return lying @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])

    def _planted(self, foot: str, toe: str) -> Float[Array, "T"]:
        """Weights of the frames in which a foot is low and slow."""
        p = 0.5 * (self.P[:, INDEX[foot]] + self.P[:, INDEX[toe]])
        speed = np.linalg.norm(np.gradient(p, axis=0), axis=1) * self.fps if self.T > 1 else p[:, 0]
        slow = _ramp(-speed, -max(0.4, np.quantile(speed, 0.25)), 0.0)
        height = p[:, 2] - np.quantile(p[:, 2], 0.05)
        return slow * _ramp(-height, -0.15, 0.0) + 1e-6

    def _clavicle(self, side: str) -> None:
        low = _ramp(-unit(self.to(side + "upperarm", side + "forearm"))[:, 2], 0.3, 0.8)
        w = self.stand * low
        w = w if w.sum() > min(5, 0.1 * self.T) else self.stand
        self.K[INDEX[side + "clavicle"]] = self._mean_frame(
            side + "clavicle", self.canonical("chest"), w
        )

    def _hand(self, side: str) -> None:
        hand, hint = side + "hand", self.hints.get(side + "hand", {})
        K = self._mean_frame(hand, self.canonical(side + "forearm"), np.ones(self.T))
        sign = 1.0 if side == "l_" else -1.0
        K = K @ axis_angle(UP, -sign * TYPICAL_PRONATION)
        up, forward = hint.get("up", K[:, 2]), hint.get("forward", K[:, 0])
        self.K[INDEX[hand]] = _frame_down(-np.asarray(up), np.cross(up, forward))


def _ramp(x: Array, low: float, high: float) -> Array:
    """0 below `low`, 1 above `high`, linear between."""
    return np.clip((x - low) / (high - low), 0.0, 1.0)


def _frame(left: Float[Array, "*b 3"], up: Float[Array, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Axes as columns from an exact left and an approximate up."""
    y = unit(left)
    x = unit(np.cross(y, up))
    return np.stack([x, y, np.cross(x, y)], -1)


def _frames(left: Float[Array, "T 3"], up: Float[Array, "T 3"]) -> Float[Array, "T 3 3"]:
    """Axes as columns from an exact up and an approximate left."""
    z = unit(up)
    x = unit(np.cross(left, z))
    return np.stack([x, np.cross(z, x), z], -1)


def _frame_down(down: Float[Array, "3"], left: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Axes as columns from an exact down and an approximate left."""
    return _frames(np.asarray(left)[None], -np.asarray(down)[None])[0]


def _frame_forward(forward: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Axes as columns from an exact forward and an approximate up."""
    x = unit(forward)
    y = unit(np.cross(up, x))
    return np.stack([x, y, np.cross(x, y)], -1)


def _swing_of_left(d: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
    """The left axis after the shortest rotation of straight down onto the directions d."""
    cross = np.cross(-UP, d)
    cos = -d[:, 2:]
    once = np.cross(cross, LEFT)
    return LEFT + once + np.cross(cross, once) / np.maximum(1.0 + cos, 1e-3)


def _nearest_rotation(M: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    U, _, Vt = np.linalg.svd(M)
    U[:, 2] *= np.sign(np.linalg.det(U @ Vt))
    return U @ Vt


def _mode(x: Float[Array, "T"], w: Float[Array, "T"], width: float) -> float:
    """Mode of a weighted sample by a Gaussian kernel density of that width."""
    grid = np.linspace(x[w > 0].min(), x[w > 0].max(), 200)
    density = np.exp(-0.5 * ((grid[:, None] - x) / width) ** 2) @ w
    return float(grid[density.argmax()])


def _angle(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b"]:
    """Rotation angles in radians."""
    return np.arccos(np.clip((np.trace(R, axis1=-2, axis2=-1) - 1.0) / 2.0, -1.0, 1.0))
