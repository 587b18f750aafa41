"""Contact shadows on the floor under feet, knees, hands and balls.

They approximate ambient occlusion, which the shadow map of the main light lacks. Each actor gets a
small texture over the floor below it, darker where the actor is lower and blurred.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import c_void_p
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap_sim.render.gl import GL, set_sampling

HEIGHT_M = 0.30  # least height without effect on the floor
DEEPEST = 0.55  # share of the light that contact removes
LIFT_M = 0.006  # over the floor, and a rug on it
CELLS, CELL_M = 64, 0.03  # cells per side of a texture, and their size
_SOFT_CELLS, _EDGE = 1.6, 7  # standard deviation and reach of the blur
_CORNERS = np.array([[0, 0], [1, 0], [0, 1], [0, 1], [1, 0], [1, 1]], np.float32)


@dataclass(frozen=True, eq=False)
class ContactShadow:
    """Factor on the light on the floor z = 0 below an actor, in square cells."""

    corner: Float[Array, "2"]  # least x and y of the texture, metres
    factor: UInt8[Array, "64 64"]  # 0..255, rows along y
    first: Int[Array, "2"]  # column and row of the shadowed part,
    last: Int[Array, "2"]  # and the ends of its range


def make_contact_shadow(positions: Float[Array, "N 3"]) -> ContactShadow | None:
    """The contact shadow of vertices [m, world]; None where there is none."""
    low = positions[positions[:, 2] < HEIGHT_M]
    if not len(low):
        return None
    first = np.floor((low[:, :2].min(0) + low[:, :2].max(0)) / 2 / CELL_M) - CELLS // 2
    at = np.floor(low[:, :2] / CELL_M - first).astype(int)
    inside = ((at >= _EDGE) & (at < CELLS - _EDGE)).all(1)
    if not inside.any():
        return None
    at = at[inside]
    height = np.full((CELLS, CELLS), HEIGHT_M, np.float32)
    over = np.maximum(low[inside, 2], 0.0).astype(np.float32)
    np.minimum.at(height.reshape(-1), at[:, 1] * CELLS + at[:, 0], over)
    closeness = (1.0 - height / HEIGHT_M) ** 2
    closeness = cv2.dilate(closeness, np.ones((3, 3), np.uint8))  # vertices may be cells apart
    soft = cv2.GaussianBlur(closeness, (0, 0), _SOFT_CELLS)
    factor = np.round(255.0 * (1.0 - DEEPEST * soft)).astype(np.uint8)
    return ContactShadow(first * CELL_M, factor, at.min(0) - _EDGE, at.max(0) + _EDGE + 1)


class ContactShadows:
    """Textures of the contact shadows of at most `actors` actors, and their drawing."""

    def __init__(self, actors: int) -> None:
        self._vertices = np.zeros((actors, 6, 6), np.float32)  # x y z, u v layer
        self._pictures = np.full((actors, CELLS, CELLS), 255, np.uint8)
        self.count = 0
        self._array = GL.glGenVertexArrays(1)
        self._buffer = GL.glGenBuffers(1)
        GL.glBindVertexArray(self._array)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._buffer)
        GL.glBufferData(
            GL.GL_ARRAY_BUFFER, self._vertices.nbytes, self._vertices, GL.GL_DYNAMIC_DRAW
        )
        for location in (0, 1):
            GL.glEnableVertexAttribArray(location)
            GL.glVertexAttribPointer(
                location, 3, GL.GL_FLOAT, GL.GL_FALSE, 24, c_void_p(12 * location)
            )
        GL.glBindVertexArray(0)
        self._texture = GL.glGenTextures(1)
        self._bind()
        GL.glTexImage3D(
            GL.GL_TEXTURE_2D_ARRAY, 0, GL.GL_R8, CELLS, CELLS, actors, 0, GL.GL_RED,
            GL.GL_UNSIGNED_BYTE, self._pictures,
        )  # fmt: skip
        set_sampling(GL.GL_TEXTURE_2D_ARRAY, GL.GL_LINEAR, GL.GL_LINEAR, GL.GL_CLAMP_TO_EDGE)

    def pose(self, positions: Mapping[str, Float[Array, "N 3"]]) -> None:
        """Update to actors with vertices at `positions` [m, world]."""
        found = [dark for posed in positions.values() if (dark := make_contact_shadow(posed))]
        self.count = len(found)
        if not found:
            return
        for layer, dark in enumerate(found):
            quad, cells = self._vertices[layer], dark.first + _CORNERS * (dark.last - dark.first)
            quad[:, :2], quad[:, 2] = dark.corner + CELL_M * cells, LIFT_M
            quad[:, 3:5], quad[:, 5] = cells / CELLS, layer
            self._pictures[layer] = dark.factor
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._buffer)
        GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, self._vertices.nbytes, self._vertices)
        self._bind()
        GL.glTexSubImage3D(
            GL.GL_TEXTURE_2D_ARRAY, 0, 0, 0, 0, CELLS, CELLS, self.count, GL.GL_RED,
            GL.GL_UNSIGNED_BYTE, self._pictures[: self.count],
        )  # fmt: skip

    def begin(self) -> None:
        """Set up multiplicative blending of colours; labels (alpha) and depth stay unchanged."""
        self._bind()
        GL.glBindVertexArray(self._array)
        GL.glEnable(GL.GL_BLEND)
        GL.glBlendFuncSeparate(GL.GL_ZERO, GL.GL_SRC_COLOR, GL.GL_ZERO, GL.GL_ONE)
        GL.glDepthMask(GL.GL_FALSE)
        GL.glDisable(GL.GL_CULL_FACE)

    def draw(self) -> None:
        """Draw all textures with the bound program."""
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 6 * self.count)

    def end(self) -> None:
        """Restore the drawing state."""
        GL.glDisable(GL.GL_BLEND)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glBindVertexArray(0)

    def boxes(self) -> tuple[Float[Array, "C 3"], Float[Array, "C 3"]]:
        """The lowest and highest corner of each texture, metres."""
        corners = self._vertices[: self.count, :, :3].astype(float)
        return corners[:, 0], corners[:, -1]

    def free(self) -> None:
        """Free the graphics memory."""
        GL.glDeleteTextures([self._texture])
        GL.glDeleteBuffers(1, [self._buffer])
        GL.glDeleteVertexArrays(1, [self._array])

    def _bind(self) -> None:
        GL.glActiveTexture(GL.GL_TEXTURE0)
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._texture)
