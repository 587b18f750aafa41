"""Bodies by name."""

import numpy as np
import pytest

from egocap.body.proportions import Proportions
from egocap.errors import EgocapError
from egocap.fitting.wearer import average_body, find_body


def standing_height(body: Proportions) -> float:
    """From the sole's ankle and the top of the head label, without foot height and crown."""
    joints = body.rest_joints
    return float(joints[0, 2] - joints[:, 2].min())


def test_an_average_body_has_the_height_asked_for():
    short, tall = average_body(1.60), average_body(1.92)
    assert np.isclose(standing_height(tall) / standing_height(short), 1.92 / 1.60, rtol=1e-9)
    assert np.array_equal(find_body("average:1.92").offsets, tall.offsets)


def test_a_file_is_read(tmp_path):
    body = average_body(1.7)
    body.save(tmp_path / "me.json")
    assert np.array_equal(find_body(str(tmp_path / "me.json")).offsets, body.offsets)


@pytest.mark.parametrize("source, message", [
    ("average", "no body 'average'"), ("average:tall", "a height of 'tall'"),
    ("average:0.4", "1.2 to 2.3"), ("fit", "without a recording"), ("nobody", "average:HEIGHT"),
    ("fit:", "no body"), ("missing.json", "no such file"),
])  # fmt: skip
def test_other_names_are_refused(source, message):
    with pytest.raises(EgocapError, match=message):
        find_body(source)
