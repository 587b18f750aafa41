"""The compiled tracing against directions written out."""

from __future__ import annotations

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap_sim.core.resources import rig_file
from egocap_sim.render.cube import cube_face, trace_pixels
from egocap_sim.scene.rig_sampler import sample_rig


@pytest.mark.parametrize("seed", [None, 400, 401, 402])
def test_every_pixel_leaves_through_its_face(seed):
    rig = load_rig(rig_file("egorig1")) if seed is None else sample_rig(np.random.default_rng(seed))
    camera = rig.resized(97, 81).cameras[0]
    rays, inside = camera.ray(np.stack(np.meshgrid(np.arange(97.0), np.arange(81.0)), -1))
    trace = trace_pixels(camera)
    np.testing.assert_array_equal(trace.face >= 0, inside)
    np.testing.assert_array_equal(
        trace.face[inside], cube_face(rays[inside], trace.faces).astype(np.int8)
    )
    assert trace.seen == np.unique(trace.face[inside]).tolist()
    for i in trace.seen:
        x, y, z = (rays[trace.face == i] @ trace.faces[i]).T
        slopes = trace.slopes[trace.face == i]
        np.testing.assert_allclose(slopes, np.stack([x / z, y / z], -1), atol=1e-6)
        np.testing.assert_array_equal(trace.bounds[i, 0::2], slopes.min(0))
        np.testing.assert_array_equal(trace.bounds[i, 1::2], slopes.max(0))
