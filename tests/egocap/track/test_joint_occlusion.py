"""Why joints are hidden, against what the renderer knows."""

import numpy as np
import pytest

from egocap.data.detections import Detections
from egocap.data.sequence import Sequence
from egocap.data.track import HIDDEN
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.pose.inverse_kinematics import nearest_angles
from egocap.track.joint_occlusion import occlusion_causes


@pytest.fixture(scope="module")
def seen(tiny_sequence):
    """A sequence, poses near its truth, and a detector that sees exactly what is visible."""
    sequence = Sequence(tiny_sequence)
    truth, person = sequence.truth, sequence.body
    angles = np.stack([nearest_angles(person, joints) for joints in truth.joints_head])
    visible = truth.visibility == VISIBLE
    found = Detections(
        truth.time, truth.joints_2d.astype(float), np.ones(visible.shape),
        visible.astype(float), np.ones(visible.shape, bool), "test",
    )  # fmt: skip
    return sequence, angles, found


def test_causes_are_those_of_the_renderer(seen):
    sequence, angles, found = seen
    causes = occlusion_causes(angles, found, sequence.rig, sequence.body)
    truth = sequence.truth.visibility
    assert causes.shape == truth.shape and causes.dtype == np.uint8
    np.testing.assert_array_equal(causes == VISIBLE, truth == VISIBLE)
    out = truth == OUT_OF_VIEW
    assert (causes[out] == OUT_OF_VIEW).mean() > 0.9 if out.any() else True
    behind = truth == SELF_OCCLUDED
    assert behind.sum() > 20
    assert (causes[behind] == SELF_OCCLUDED).mean() > 0.6


def test_what_nothing_hides_is_unknown(seen):
    sequence, angles, found = seen
    visible = sequence.truth.visibility == VISIBLE
    found.confidence[:] = 0.0
    causes = occlusion_causes(angles, found, sequence.rig, sequence.body)
    assert (causes[visible] == OCCLUDED).mean() > 0.6
    assert (causes != VISIBLE).all()
    found.confidence[:], found.valid[:] = 1.0, False
    again = occlusion_causes(angles, found, sequence.rig, sequence.body)
    np.testing.assert_array_equal(again, causes)


def test_every_code_has_a_name():
    assert [HIDDEN[c] for c in (VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED, OCCLUDED)] == [
        "seen", "out of view", "own body", "object or unknown",
    ]  # fmt: skip
