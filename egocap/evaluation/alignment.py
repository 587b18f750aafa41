"""Least-squares alignments of one point set to another, frame by frame.

Axes are always (..., J, 3): joints second to last, coordinates last. Nothing is read off the shape.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array


def fit_similarity(
    source: Float[Array, "*batch J 3"],
    target: Float[Array, "*batch J 3"],
    mask: Bool[Array, "*batch J"] | None = None,
    *,
    scaled: bool = True,
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch 3 3"], Float[Array, "*batch 3"]]:
    """Scale s, rotation R and translation t that minimise sum_j |target_j - s R source_j - t|^2.

    R is a proper rotation: a mirrored source is never reflected onto its target. `mask` says which
    joints count (all, when None). `scaled` False holds s at 1. A source whose points coincide gets
    s = 0, which maps it to the target's centroid.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point
    patterns, PAMI 1991, eq. 40-43.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    keep = (np.ones(source.shape[:-1], bool) if mask is None else mask)[..., None]
    count = np.maximum(keep.sum(-2), 1)
    # by selection, not by a weight of zero: NaN in a masked joint must not leak in
    centre_source = np.where(keep, source, 0.0).sum(-2) / count
    centre_target = np.where(keep, target, 0.0).sum(-2) / count
    a = np.where(keep, source - centre_source[..., None, :], 0.0)
    b = np.where(keep, target - centre_target[..., None, :], 0.0)
    U, singular, Vt = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    sign = np.ones_like(singular)
    sign[..., 2] = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0, -1.0, 1.0)
    R = (U * sign[..., None, :]) @ Vt
    if scaled:
        spread = (a**2).sum((-2, -1))
        s = (singular * sign).sum(-1) / np.where(spread > 0, spread, 1.0)
    else:
        s = np.ones(source.shape[:-2])
    t = centre_target - s[..., None] * (R @ centre_source[..., None])[..., 0]
    return s, R, t


def align_similarity(
    predicted: Float[Array, "*batch J 3"],
    truth: Float[Array, "*batch J 3"],
    mask: Bool[Array, "*batch J"] | None = None,
) -> Float[Array, "*batch J 3"]:
    """Predicted poses after the best similarity (rotation, translation, scale) of each frame."""
    return _apply(predicted, *fit_similarity(predicted, truth, mask))


def align_rigid(
    predicted: Float[Array, "*batch J 3"],
    truth: Float[Array, "*batch J 3"],
    mask: Bool[Array, "*batch J"] | None = None,
) -> Float[Array, "*batch J 3"]:
    """Predicted poses after the best rotation and translation of each frame."""
    return _apply(predicted, *fit_similarity(predicted, truth, mask, scaled=False))


def align_sequence(
    predicted: Float[Array, "T J 3"],
    truth: Float[Array, "T J 3"],
    mask: Bool[Array, "T J"] | None = None,
    *,
    scaled: bool = True,
) -> Float[Array, "T J 3"]:
    """Predicted poses after the one similarity that fits all frames together best.

    `scaled` False: the one rotation and translation, as for a trajectory of known scale.
    """
    flat = None if mask is None else mask.reshape(-1)
    s, R, t = fit_similarity(predicted.reshape(-1, 3), truth.reshape(-1, 3), flat, scaled=scaled)
    return s * predicted @ R.T + t


def resize_bones(
    points: Float[Array, "*batch J 3"],
    lengths: Float[Array, "*batch K"],
    bones: tuple[tuple[int, int], ...],
) -> Float[Array, "*batch J 3"]:
    """Poses with every bone (parent, child) brought to its length, its direction kept.

    `bones` lists parents before their children; joints of no bone stay. A bone of length 0 has no
    direction and stays as it is.
    """
    resized = np.array(points, np.float64)
    for k, (parent, child) in enumerate(bones):
        bone = points[..., child, :] - points[..., parent, :]
        size = np.linalg.norm(bone, axis=-1, keepdims=True)
        unit = np.divide(bone, size, out=np.zeros_like(bone, np.float64), where=size > 0)
        resized[..., child, :] = resized[..., parent, :] + lengths[..., k, None] * unit
    return resized


def align_root(
    predicted: Float[Array, "*batch J 3"],
    truth: Float[Array, "*batch J 3"],
    root: tuple[int, ...],
) -> Float[Array, "*batch J 3"]:
    """Predicted poses moved so that the mean of the joints `root` agrees with the truth's."""
    index = list(root)
    shift = truth[..., index, :].mean(-2) - predicted[..., index, :].mean(-2)
    return predicted + shift[..., None, :]


def _apply(points: Array, s: Array, R: Array, t: Array) -> Array:
    rotated = points @ np.swapaxes(R, -1, -2)
    return s[..., None, None] * rotated + t[..., None, :]
