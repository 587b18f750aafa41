"""A reference motion as it is, without forces: for people who are only looked at."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.geometry import matrix_to_quaternion, quaternion_to_matrix, rigid
from egocap_sim.human.body.person import Person
from egocap_sim.motion.kinematics.figure import joint_positions
from egocap_sim.motion.retarget.retarget import Reference, continuous


def sample_reference(
    person: Person, reference: Reference, times: Float[Array, "T"]
) -> Float[Array, "T 21 4 4"]:
    """World body frames at times in seconds; before its start and after its end it stands still.

    Standing feet keep still as the reference holds them: both are sampled between the same keys.
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
