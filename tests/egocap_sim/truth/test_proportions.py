"""A simulated person measured on the tracker's skeleton."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.clothing.wardrobe import make_person
from egocap_sim.truth.proportions import measure_proportions


@pytest.fixture(scope="module")
def person():
    return make_person(2)


def test_bones_are_the_persons(person):
    lengths = measure_proportions(person).bone_lengths
    for bone, (start, end) in {
        "left_elbow": ("l_upperarm", "l_forearm"),
        "right_wrist": ("r_forearm", "r_hand"),
        "left_knee": ("l_thigh", "l_calf"),
        "right_ankle": ("r_calf", "r_foot"),
    }.items():
        span = person.joints[INDEX[end]] - person.joints[INDEX[start]]
        assert lengths[bone] == pytest.approx(np.linalg.norm(span))
    assert lengths["left_hand"] == pytest.approx(np.linalg.norm(person.landmarks["left_hand"]))


def test_trunk_keeps_its_place_in_the_head_frame(person):
    rest = measure_proportions(person).rest_joints
    head = person.joints[INDEX["head"]]
    for label, body in {
        "neck": "neck", "left_shoulder": "l_upperarm", "right_hip": "r_thigh",
    }.items():  # fmt: skip
        assert np.allclose(rest[LABEL_INDEX[label]], person.joints[INDEX[body]] - head)
    assert np.allclose(rest[LABEL_INDEX["head"]], person.landmarks["head"])


def test_sides_are_about_equal(person):
    lengths = measure_proportions(person).bone_lengths
    for name, length in lengths.items():
        if name.startswith("left_"):
            assert length == pytest.approx(lengths[name.replace("left", "right")], abs=0.005)
