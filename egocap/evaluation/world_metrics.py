"""Measures of a motion in the world: drift, sliding and sinking feet, contacts, jitter.

Sliding, sinking and contacts need only the ground: without a world of the method's own, the true
head pose places its motion. Drift is measured of a method's own world alone. Alignments are rigid:
the scale is the method's to find.

Source: Ye et al., Decoupling human and camera motion from videos in the wild, CVPR 2023 (world
errors after the alignment of the first frame and of all frames); Shin et al., WHAM, CVPR 2024 (root
translation error as a share of the distance).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.labels import LABEL_INDEX
from egocap.evaluation import metrics
from egocap.evaluation.alignment import align_sequence, fit_similarity
from egocap.evaluation.pose_errors import FEET, MM, TOES, PoseErrors

NAN = float("nan")
HIPS = (LABEL_INDEX["left_hip"], LABEL_INDEX["right_hip"])
NEAR_M = 0.25
"""Ground is known around the places where feet truly stood, to this horizontal distance."""
SHORTEST_M = 1.0
"""Shortest way of which an error is a share."""
ROLLS = 0.1
"""Horizontal speed, m/s, above which a true toe in contact rolls off or slides: it is not planted.
A walker's toes reach 0.3 m/s before their contact ends, a mean of 0.03 over all frames of contact.
"""


def skate(errors: PoseErrors) -> float:
    """Mean horizontal speed of toes that truly touch and stay, m/s (`metrics.foot_skate`)."""
    world, truth, contact = errors.world, errors.true_world, errors.truth.contact
    if world is None or truth is None or contact is None or len(truth) < 2:
        return NAN
    moves, _ = metrics.foot_speed(truth[:, TOES], errors.truth.times)
    planted = contact[:, [1, 3]] & world.known[:, None] & (moves <= ROLLS)
    return metrics.foot_skate(world.joints[:, TOES], planted, errors.truth.times)


def contact_f1(errors: PoseErrors) -> float:
    """F1 of planted feet: those a method states, otherwise those of `metrics.estimate_planted`.

    A foot is planted that touches with heel or toe; for a method, with a probability of 0.5. Frames
    count where true contacts are known (`GroundTruth.propped`).
    """
    world, contact, times = errors.world, errors.truth.contact, errors.truth.times
    if world is None or contact is None or world.known.sum() < 2:
        return NAN
    known = world.known
    if world.contacts is None:
        found = metrics.estimate_planted(world.joints[known][:, TOES], times[known])
    else:
        found = touching_feet(world.contacts[known] >= 0.5)
    truth = touching_feet(contact[known])
    counted = ... if errors.truth.propped is None else ~errors.truth.propped[known]
    return metrics.f1_score(found[counted], truth[counted])


def sinking(errors: PoseErrors) -> float:
    """Mean depth of ankles and toes below the ground over all frames, mm.

    The ground of a joint is the lowest place, within `NEAR_M` in plan, at which that joint of
    either foot truly was while heel or toe touched; frames without such a place do not count. A
    method's own world is aligned to the true one over all frames first.
    """
    world, truth, contact = errors.world, errors.true_world, errors.truth.contact
    if world is None or truth is None or contact is None or not world.known.any():
        return NAN
    joints = world.joints
    if errors.own_world is not None:
        placed = errors.valid & world.known[:, None]
        joints = align_sequence(world.joints, truth, placed, scaled=False)
    depths = []
    for part in (0, 1):
        feet, columns = list(FEET[part::2]), [part, part + 2]
        depths.append(penetration(joints[world.known][:, feet], truth[:, feet],
                                  contact[:, columns]))  # fmt: skip
    depth = np.concatenate(depths)
    return MM * float(depth.mean()) if len(depth) else NAN


def penetration(
    feet: Float[Array, "T F 3"], true_feet: Float[Array, "N F 3"], planted: Bool[Array, "N F"]
) -> Float[Array, "K"]:
    """Depth of feet below the ground that true feet stood on, where that is known, metres."""
    from scipy.spatial import KDTree

    stood = true_feet[planted]
    if not len(stood):
        return np.zeros(0)
    points = feet.reshape(-1, 3)
    near = KDTree(stood[:, :2]).query_ball_point(points[:, :2], NEAR_M)
    depths = [stood[found, 2].min() - point[2] for found, point in zip(near, points, strict=True)
              if found]  # fmt: skip
    return np.maximum(np.array(depths), 0.0)


def first_aligned(errors: PoseErrors) -> float:
    """Mean joint error in the world after the rigid motion that fits the first frame, mm."""
    predicted, truth, counted = _world(errors)
    if not counted.any():
        return NAN
    first = int(np.argmax(counted.any(1)))
    s, R, t = fit_similarity(predicted[first], truth[first], counted[first], scaled=False)
    moved = s * predicted @ R.T + t
    return MM * metrics.mean_error(metrics.joint_errors(moved, truth), counted)


def all_aligned(errors: PoseErrors) -> float:
    """Mean joint error in the world after the one rigid motion that fits all frames, mm."""
    predicted, truth, counted = _world(errors)
    if not counted.any():
        return NAN
    moved = align_sequence(predicted, truth, counted, scaled=False)
    return MM * metrics.mean_error(metrics.joint_errors(moved, truth), counted)


def root_error(errors: PoseErrors) -> float:
    """Mean error of the hips' middle, percent of its way, after the rigid fit of all frames.

    NaN for a way of less than `SHORTEST_M`.
    """
    world, truth = errors.own_world, errors.true_world
    if world is None or truth is None or world.known.sum() < 2:
        return NAN
    root = truth[world.known][:, HIPS].mean(1)
    way = float(np.linalg.norm(np.diff(root, axis=0), axis=1).sum())
    if way < SHORTEST_M:
        return NAN
    found = world.joints[world.known][:, HIPS].mean(1)
    moved = align_sequence(found[:, None], root[:, None], scaled=False)[:, 0]
    return 100.0 * float(np.linalg.norm(moved - root, axis=1).mean()) / way


def acceleration(errors: PoseErrors) -> float:
    """Mean acceleration error of the joints in the world, all frames aligned, m/s^2."""
    predicted, truth, counted = _world(errors)
    if not counted.any():
        return NAN
    moved = align_sequence(predicted, truth, counted, scaled=False)
    return metrics.acceleration_error(moved, truth, errors.truth.times, counted)


def _world(
    errors: PoseErrors,
) -> tuple[Float[Array, "T J 3"], Float[Array, "T J 3"], Bool[Array, "T J"]]:
    """The protocol's joints in the method's own world and the true one, and those that count."""
    index, world, truth = list(errors.protocol.joints), errors.own_world, errors.true_world
    if world is None or truth is None:
        nothing = np.zeros((len(errors.predicted), len(index), 3))
        return nothing, nothing, np.zeros(nothing.shape[:2], bool)
    counted = errors.counted[:, index] & world.known[:, None]
    return world.joints[:, index], truth[:, index], counted


def touching_feet(contact: Bool[Array, "T 4"]) -> Bool[Array, "T 2"]:
    """Whether heel or toe of a foot touches."""
    return contact[:, [0, 2]] | contact[:, [1, 3]]
