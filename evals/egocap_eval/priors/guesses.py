"""Detections of a take as a learned detector gives them: also of joints that nobody sees.

A detector guesses hidden joints from a single image: all of them in one plausible pose, the same in
every view, which swings less than the person does. Visible joints have errors with heavy tails;
both persist over time. In some episodes a limb is detected elsewhere. The sizes below, by label and
visibility, are those of earlier weights: errors are larger than the shipped detector's.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.labels import LABEL_INDEX, LABELS, without_side
from egocap.body.skeleton import DOF_COUNT, SPREAD, forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.image_model.occlusion import joints_seen
from egocap_eval.priors.takes import FPS, Take

REFERENCE_WIDTH = 640  # px
_SEEN_PX = {
    "head": 1.3, "neck": 1.6, "shoulder": 2.2, "elbow": 2.7, "wrist": 1.9, "hand": 2.1,
    "hip": 2.4, "knee": 2.4, "ankle": 1.3, "foot": 0.9,
}  # fmt: skip
_HIDDEN_PX = {
    "head": 1.4, "neck": 2.2, "shoulder": 2.4, "elbow": 4.3, "wrist": 7.6, "hand": 8.4,
    "hip": 3.0, "knee": 5.4, "ankle": 5.8, "foot": 8.4,
}  # fmt: skip
"""Medians of the stated standard deviations, pixels at that width, of the weights of commit a6442e2
on validation footage; no command measures them again."""
_OVERCONFIDENCE, _DEGREES = 1.05, 4  # of visible joints; Student's t
_SWING = (0.4, 0.95)
"""Fraction of the motion about its mean pose that guesses show; drawn for every take."""
_GUESS_SPREAD = 0.11
"""Standard deviation of guessed angles, relative to that of everyday poses."""
_MISS, _ASTRAY = 2.0, 2.2
"""Levels that a standard Gaussian process exceeds in episodes: missed joints, limbs elsewhere."""
_ASTRAY_PX, _ASTRAY_IN_VIEW = (20.0, 80.0), 0.6
_LIMBS = tuple(
    [LABEL_INDEX[f"{side}_{part}"] for part in parts]
    for side in ("left", "right")
    for parts in (("elbow", "wrist", "hand"), ("wrist", "hand"), ("knee", "ankle", "foot"))
)


def guess_detections(take: Take, rig: Rig, rng: np.random.Generator) -> Detections:
    """Detections of a take by a rig."""
    T, V = len(take.angles), len(rig.mounts)
    seen = _seen(take, rig) & ~(_process(rng, T, (V, 18), 0.9) > _MISS)
    true, inside = _project(rig, take.joints_head)
    guessed, _ = _project(rig, forward(take.person, _guessed_angles(take.angles, rng)))
    scale = rig.mounts[0].camera.width / REFERENCE_WIDTH
    seen_px, hidden_px = (
        scale * np.array([table[without_side(label)] for label in LABELS])
        for table in (_SEEN_PX, _HIDDEN_PX)
    )
    sigma = np.where(seen, seen_px, hidden_px) * np.exp(0.4 * _process(rng, T, (V, 18), 0.9))
    noise = sigma[..., None] * _student_t(rng, T, (V, 18, 2))
    points = np.where(seen[..., None], true + _OVERCONFIDENCE * noise, guessed + 0.5 * noise)
    points += scale * _astray(rng, T, V)
    sure = 1.0 - 0.1 * np.abs(_process(rng, T, (V, 18), 0.8))
    unsure = np.exp(_process(rng, T, (V, 18), 0.9) - 2.5)
    width, height = rig.mounts[0].camera.width, rig.mounts[0].camera.height
    with np.errstate(invalid="ignore"):
        valid = inside & np.all((points >= -0.5) & (points <= (width - 0.5, height - 0.5)), -1)
    confidence = np.clip(np.where(seen, sure, unsure), 0.005, 1.0)
    return Detections(
        np.arange(T) / FPS, np.where(valid[..., None], points, np.nan), sigma,
        np.where(valid, confidence, 0.0), valid, "guesses",
    )  # fmt: skip


def _seen(take: Take, rig: Rig) -> Bool[Array, "T V 18"]:
    joints = np.ascontiguousarray(take.joints_head)
    return joints_seen(take.angles, joints, GaussianBody.from_proportions(take.person), rig)


def _project(
    rig: Rig, joints: Float[Array, "T 18 3"]
) -> tuple[Float[Array, "T V 18 2"], Bool[Array, "T V 18"]]:
    points, inside = rig.project(joints)
    return np.moveaxis(points, 0, 1), np.moveaxis(inside, 0, 1)


def _guessed_angles(angles: Float[Array, "T 37"], rng: np.random.Generator) -> Float[Array, "T 37"]:
    """A pose near that of every frame, with less swing."""
    T, usual = len(angles), angles.mean(axis=0)
    size = _GUESS_SPREAD * np.exp(0.35 * rng.standard_normal() + 0.4 * _process(rng, T, (1,), 0.97))
    window = np.hanning(7)[1:-1] / np.hanning(7).sum()
    drift = np.pad(_process(rng, T, (DOF_COUNT,), 0.9), ((2, 2), (0, 0)), mode="edge")
    drift = np.stack([np.convolve(column, window, "valid") for column in drift.T], -1)
    return usual + rng.uniform(*_SWING) * (angles - usual) + size * SPREAD * drift


def _astray(rng: np.random.Generator, T: int, V: int) -> Float[Array, "T V 18 2"]:
    """Shifts of limbs in some episodes, pixels at the reference width."""
    shift = np.zeros((T, V, 18, 2))
    for limb in _LIMBS:
        on = _process(rng, T, (), 0.95) > _ASTRAY
        turn = rng.uniform(0.0, 2.0 * np.pi)
        away = rng.uniform(*_ASTRAY_PX) * np.array([np.cos(turn), np.sin(turn)])
        for v in np.flatnonzero(rng.random(V) < _ASTRAY_IN_VIEW):
            shift[np.ix_(np.flatnonzero(on), [v], limb)] += away  # type: ignore[list-item]
    return shift


def _process(
    rng: np.random.Generator, T: int, shape: tuple[int, ...], memory: float
) -> Float[Array, "T *shape"]:
    """First-order autoregression of unit variance; `memory`: correlation from frame to frame."""
    made = rng.standard_normal((T, *shape))
    for t in range(1, T):
        made[t] = memory * made[t - 1] + np.sqrt(1.0 - memory**2) * made[t]
    return made


def _student_t(
    rng: np.random.Generator, T: int, shape: tuple[int, ...], memory: float = 0.8
) -> Float[Array, "T *shape"]:
    squares = _process(rng, T, (*shape[:-1], 1, _DEGREES), memory) ** 2
    return _process(rng, T, shape, memory) / np.sqrt(squares.mean(axis=-1))
