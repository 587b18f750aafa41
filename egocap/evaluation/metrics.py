"""The measures: one small pure function each, in the units of its input, in float64.

Axes are (T, J, 3) for poses and (T, V, J, 2) for image points, never read off the shape, so a score
does not depend on how many frames are scored together. Masks are separate arrays; what a masked
entry holds is never read.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.errors import InputError

REFERENCE_WIDTH = 640  # pixels: image thresholds are stated at 640 x 512

PLANTED_SPEED = 0.6  # m/s, below which a foot may be planted
PLANTED_HEIGHT = 0.03  # metres above the lowest toe of the last and next `WINDOW_S`
WINDOW_S = 0.5


def joint_errors(
    predicted: Float[Array, "T J 3"], truth: Float[Array, "T J 3"]
) -> Float[Array, "T J"]:
    """Euclidean distance of every joint to its truth."""
    _same_shape(predicted, truth, axes="T J 3")
    return np.linalg.norm(np.asarray(predicted, np.float64) - truth, axis=-1)


def mean_error(errors: Float[Array, "T J"], mask: Bool[Array, "T J"] | None = None) -> float:
    """Mean over frames and joints (MPJPE of `joint_errors`); NaN when the mask leaves nothing."""
    values = _selected(errors, mask)
    return float(values.mean()) if values.size else float("nan")


def mean_error_per_joint(
    errors: Float[Array, "T J"], mask: Bool[Array, "T J"] | None = None
) -> Float[Array, "J"]:
    """Mean over frames of every joint; NaN for a joint the mask leaves out in all frames."""
    mask = np.ones(errors.shape, bool) if mask is None else mask
    count = mask.sum(0)
    total = np.where(mask, errors, 0.0).sum(0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def percentile(
    errors: Float[Array, "T J"], percent: float, mask: Bool[Array, "T J"] | None = None
) -> float:
    """Percentile over frames and joints (linear between ranks); NaN when nothing is left."""
    values = _selected(errors, mask)
    return float(np.percentile(values, percent)) if values.size else float("nan")


def acceleration(
    points: Float[Array, "T J 3"], times: Float[Array, "T"]
) -> Float[Array, "T-2 J 3"]:
    """Second derivative by central differences, exact for parabolas at any frame times.

    Args:
        points: metres.
        times: seconds, strictly increasing; the spacing may vary (dropped frames).

    Raises:
        InputError: the times do not increase or their number differs.
    """
    times = np.asarray(times, np.float64)
    if times.shape != (len(points),):
        raise InputError(f"{len(points)} frames but times of shape {times.shape}")
    step = np.diff(times)
    if (step <= 0).any():
        frame = int(np.argmax(step <= 0)) + 1
        raise InputError(f"times do not increase at frame {frame} ({times[frame]:g} s)")
    velocity = np.diff(np.asarray(points, np.float64), axis=0) / step[:, None, None]
    return np.diff(velocity, axis=0) / (0.5 * (step[1:] + step[:-1]))[:, None, None]


def acceleration_error(
    predicted: Float[Array, "T J 3"],
    truth: Float[Array, "T J 3"],
    times: Float[Array, "T"],
    mask: Bool[Array, "T J"] | None = None,
) -> float:
    """Mean length of the difference of accelerations, m/s^2: jitter. NaN below three frames.

    `mask`: predicted joints that exist; only three in a row have an acceleration.

    Source: Kanazawa et al., Learning 3D human dynamics from video, CVPR 2019, section 4 (there in
    millimetres per frame interval squared).
    """
    _same_shape(predicted, truth, axes="T J 3")
    difference = acceleration(predicted, times) - acceleration(truth, times)
    kept = None if mask is None else mask[2:] & mask[1:-1] & mask[:-2]
    return mean_error(np.linalg.norm(difference, axis=-1), kept)


def velocity_error(
    predicted: Float[Array, "T J 3"],
    truth: Float[Array, "T J 3"],
    times: Float[Array, "T"],
    mask: Bool[Array, "T J"] | None = None,
) -> float:
    """Mean length of the difference of velocities, m/s (MPJVE). NaN below two frames.

    Source: Pavllo et al., 3D human pose estimation in video, CVPR 2019 (there a frame interval).
    """
    _same_shape(predicted, truth, axes="T J 3")
    step = np.diff(np.asarray(times, np.float64))[:, None, None]
    difference = np.diff(np.asarray(predicted, np.float64) - truth, axis=0) / step
    kept = None if mask is None else mask[1:] & mask[:-1]
    return mean_error(np.linalg.norm(difference, axis=-1), kept)


def bone_lengths(
    points: Float[Array, "T J 3"], bones: tuple[tuple[int, int], ...]
) -> Float[Array, "T K"]:
    """Length of every bone (pair of joints) in every frame."""
    first, second = np.array(bones).T
    return np.linalg.norm(np.asarray(points, np.float64)[:, first] - points[:, second], axis=-1)


def bone_length_error(
    predicted: Float[Array, "T J 3"],
    truth: Float[Array, "T J 3"],
    bones: tuple[tuple[int, int], ...],
    mask: Bool[Array, "T J"] | None = None,
) -> float:
    """Mean absolute difference of bone lengths over frames and bones, of bones with both ends."""
    difference = np.abs(bone_lengths(predicted, bones) - bone_lengths(truth, bones))
    return mean_error(difference, None if mask is None else _both_ends(mask, bones))


def bone_length_drift(
    points: Float[Array, "T J 3"],
    bones: tuple[tuple[int, int], ...],
    mask: Bool[Array, "T J"] | None = None,
) -> Float[Array, "K"]:
    """Standard deviation over time of every bone's length: 0 for a skeleton that keeps its size.

    NaN for a bone that the mask leaves out in all frames.
    """
    lengths = bone_lengths(points, bones)
    kept = np.ones(lengths.shape, bool) if mask is None else _both_ends(mask, bones)
    mean = mean_error_per_joint(lengths, kept)
    return np.sqrt(mean_error_per_joint((lengths - mean) ** 2, kept))


def foot_speed(
    feet: Float[Array, "T F 3"], times: Float[Array, "T"]
) -> tuple[Float[Array, "T F"], Float[Array, "T F"]]:
    """Horizontal and whole speed of each foot, m/s, by central differences (one-sided at the ends).

    Frames may be unevenly spaced. Needs two frames or more.
    """
    velocity = np.gradient(np.asarray(feet, np.float64), np.asarray(times, np.float64), axis=0)
    return np.linalg.norm(velocity[..., :2], axis=-1), np.linalg.norm(velocity, axis=-1)


def foot_skate(
    feet: Float[Array, "T F 3"], planted: Bool[Array, "T F"], times: Float[Array, "T"]
) -> float:
    """Mean horizontal speed of the feet while they are truly planted, m/s; NaN if they never are.

    Frames count whose neighbours are planted too, so that landing and lifting are no skating.
    """
    if len(feet) < 3:
        return float("nan")
    inside = planted.copy()
    inside[1:] &= planted[:-1]
    inside[:-1] &= planted[1:]
    horizontal, _ = foot_speed(feet, times)
    return float(horizontal[inside].mean()) if inside.any() else float("nan")


def estimate_planted(feet: Float[Array, "T F 3"], times: Float[Array, "T"]) -> Bool[Array, "T F"]:
    """Feet that stand: slow, and low among the toes' heights of the second around.

    The floor's height is not asked for; on stairs fewer are found, and none while lying. On true
    joints the rule's F1 is 0.94 (a foot is planted that touches with heel or toe): report it beside
    a method's.
    """
    times = np.asarray(times, np.float64)
    _, speed = foot_speed(feet, times)
    lowest = feet[..., 2].min(-1)
    floor = lowest.copy()
    for apart in range(1, len(times)):
        near = times[apart:] - times[:-apart] <= WINDOW_S
        if not near.any():
            break
        earlier, later = floor[:-apart], floor[apart:]
        np.minimum(earlier, lowest[apart:], out=earlier, where=near)
        np.minimum(later, lowest[:-apart], out=later, where=near)
    return (speed <= PLANTED_SPEED) & (feet[..., 2] - floor[:, None] <= PLANTED_HEIGHT)


def f1_score(predicted: Bool[Array, "*axes"], truth: Bool[Array, "*axes"]) -> float:
    """Harmonic mean of precision and recall, 0 to 1; NaN when neither says yes anywhere."""
    total = int(predicted.sum()) + int(truth.sum())
    return 2.0 * int((predicted & truth).sum()) / total if total else float("nan")


def pixel_errors(
    predicted: Float[Array, "T V J 2"],
    truth: Float[Array, "T V J 2"],
    image_widths: Float[Array, "V"],
) -> Float[Array, "T V J"]:
    """Distance of every image point to its truth, in pixels of an image `REFERENCE_WIDTH` wide."""
    _same_shape(predicted, truth, axes="T V J 2")
    scale = REFERENCE_WIDTH / np.asarray(image_widths, np.float64)
    if scale.shape != predicted.shape[1:2]:
        raise InputError(f"{predicted.shape[1]} views but image widths of shape {scale.shape}")
    return np.linalg.norm(np.asarray(predicted, np.float64) - truth, axis=-1) * scale[:, None]


def pck(
    errors: Float[Array, "*axes"],
    detected: Bool[Array, "*axes"],
    counted: Bool[Array, "*axes"],
    threshold: float,
) -> float:
    """Percentage of the counted joints found within `threshold` (<=); a missing one is a miss.

    NaN when nothing is counted. Source: the paper, section 5.3 (PCK at 20 px of 640 x 512).
    """
    if not counted.any():
        return float("nan")
    hits = detected & (np.where(detected & counted, errors, np.inf) <= threshold)
    return 100.0 * float(hits[counted].mean())


def auc(
    errors: Float[Array, "*axes"],
    detected: Bool[Array, "*axes"],
    counted: Bool[Array, "*axes"],
    limit: float,
) -> float:
    """Area under the PCK curve from 0 to `limit`, in percent of the largest possible area.

    The curve is integrated exactly rather than sampled: a joint with error e contributes
    max(0, 1 - e / limit), a missing one 0. A perfect prediction scores 100. NaN when nothing is
    counted.
    """
    if not counted.any():
        return float("nan")
    error = np.where(detected & counted, errors, np.inf)[counted]
    return 100.0 * float(np.clip(1.0 - error / limit, 0.0, None).mean())


def bootstrap_interval(
    values: Float[Array, "T"],
    rng: np.random.Generator,
    *,
    block: int = 1,
    level: float = 0.95,
    draws: int = 2000,
) -> tuple[float, float]:
    """Confidence interval of the mean by the circular block bootstrap.

    Neighbouring frames err alike, so whole runs of `block` frames are drawn; block 1 is the plain
    bootstrap and too narrow for a video.

    Raises:
        InputError: fewer than two blocks of values, which say nothing about their spread.

    Source: Politis and Romano, A circular block-resampling procedure for stationary data, 1992.
    """
    count = len(values)
    if block < 1 or count < 2 * block:
        raise InputError(
            f"cannot bootstrap {count} values in blocks of {block}", valid="two blocks or more"
        )
    around = np.concatenate([values, values[: block - 1]])
    sums = np.concatenate([[0.0], np.cumsum(around, dtype=np.float64)])
    block_means = (sums[block:] - sums[:-block]) / block  # (T,) mean of the block from each start
    starts = rng.integers(count, size=(draws, -(-count // block)))
    means = block_means[starts].mean(1)
    low, high = np.quantile(means, [0.5 - level / 2, 0.5 + level / 2])
    return float(low), float(high)


def paired_interval(
    first: Float[Array, "T"],
    second: Float[Array, "T"],
    rng: np.random.Generator,
    *,
    block: int = 1,
    level: float = 0.95,
    draws: int = 2000,
) -> tuple[float, float]:
    """Confidence interval of the mean of `second - first`, measured on the same frames.

    What makes a frame hard is in both and cancels; an interval without 0 is a change beyond noise.

    Raises:
        InputError: the numbers of frames differ, or there are fewer than two blocks.
    """
    if len(first) != len(second):
        raise InputError(f"{len(first)} and {len(second)} frames cannot be paired")
    difference = np.asarray(second, np.float64) - first
    return bootstrap_interval(difference, rng, block=block, level=level, draws=draws)


def _selected(errors: Array, mask: Array | None) -> Array:
    return np.asarray(errors, np.float64)[... if mask is None else mask]


def _both_ends(mask: Bool[Array, "T J"], bones: tuple[tuple[int, int], ...]) -> Array:
    first, second = np.array(bones).T
    return mask[:, first] & mask[:, second]


def _same_shape(predicted: Array, truth: Array, *, axes: str) -> None:
    names = axes.split()
    for what, points in (("predicted", predicted), ("true", truth)):
        if points.ndim != len(names) or points.shape[-1] != int(names[-1]):
            raise InputError(
                f"{what} points have shape {points.shape}", valid=f"({', '.join(names)})"
            )
    if predicted.shape != truth.shape:
        raise InputError(
            f"predicted points have shape {predicted.shape}, the truth {truth.shape}",
            valid=f"the same ({', '.join(names)})",
        )
