"""Levels of a texture array as they arrive, against means of four pixels."""

from __future__ import annotations

import numpy as np

from egocap_sim.render.batch import Layer
from egocap_sim.render.gl import GL, Context
from egocap_sim.render.gpu import texture_array


def test_each_level_is_the_mean_of_the_one_before():
    context = Context.borrow()
    rng = np.random.default_rng(0)
    textures = [rng.integers(0, 256, (n, n, 3), dtype=np.uint8) for n in (16, 4)]
    name = texture_array([Layer(textures[0], 40), Layer(textures[1], 255)])
    finer = None
    for level in range(5):
        side = 16 >> level
        found = np.empty((2, side, side, 4), np.uint8)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glGetTexImage(
            GL.GL_TEXTURE_2D_ARRAY, level, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, found
        )  # fmt: skip
        assert (found[0, ..., 3] == 40).all() and (found[1, ..., 3] == 255).all()
        if finer is None:
            np.testing.assert_array_equal(found[0, ..., :3], textures[0])
        else:
            mean = finer.reshape(2, side, 2, side, 2, 4).mean((2, 4))
            assert np.abs(found - mean).max() <= 0.5
        finer = found.astype(float)
    GL.glDeleteTextures([name])
    context.release()
