"""`distinct` against `numpy.unique`."""

import numpy as np
import pytest

from egocap_sim.human.body.triangles import distinct


@pytest.mark.parametrize("numbers", [[], [7], [3, 0, 3, 9, 0], list(range(5))])
def test_distinct_is_unique(numbers):
    numbers = np.array(numbers, int)
    _, first, index = np.unique(numbers, return_index=True, return_inverse=True)
    found = distinct(numbers)
    assert np.array_equal(found[0], first)
    assert np.array_equal(found[1], index)
