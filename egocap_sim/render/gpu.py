"""Batches in graphics memory, and texture arrays."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_void_p

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap_sim.render.batch import Batch, Layer
from egocap_sim.render.gl import GL, draw_runs, set_sampling

MAX_SIZE = 1024  # pixels along a texture


_SIZES = (3, 3, 2, 2)  # of a vertex: position, normal, place in the texture, layer and part


class GpuBatch:
    """Vertex buffer, index buffer and texture array of one batch."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self._vertices = np.concatenate(
            [batch.positions, batch.normals, batch.uv, batch.layer_part], axis=1
        ).astype(np.float32)
        self._array = GL.glGenVertexArrays(1)
        GL.glBindVertexArray(self._array)
        self._buffers = [
            _filled_buffer(GL.GL_ARRAY_BUFFER, self._vertices),
            _filled_buffer(GL.GL_ELEMENT_ARRAY_BUFFER, batch.faces.astype(np.uint32)),
        ]
        stride, offset = self._vertices.strides[0], 0
        for location, size in enumerate(_SIZES):
            place = c_void_p(offset)
            GL.glVertexAttribPointer(location, size, GL.GL_FLOAT, GL.GL_FALSE, stride, place)
            GL.glEnableVertexAttribArray(location)
            offset += 4 * size
        GL.glBindVertexArray(0)
        self._texture = texture_array(batch.layers)
        self._double_sided = np.array([c.double_sided for c in batch.chunks])
        self.casts_shadow = np.array([c.casts_shadow for c in batch.chunks])
        self._offset = np.array([4 * c.first for c in batch.chunks], np.uintp)  # bytes
        self._count = np.array([c.count for c in batch.chunks])

    def upload(self, positions: Float[Array, "N 3"], normals: Float[Array, "N 3"]) -> None:
        """Upload posed vertices and normals."""
        self._vertices[:, :3], self._vertices[:, 3:6] = positions, normals
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._buffers[0])
        GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, self._vertices.nbytes, self._vertices)

    def bind_textures(self, unit: int) -> None:
        """Bind the texture array to a texture unit."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)  # pyright: ignore[reportOperatorIssue]
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._texture)

    def draw(self, chosen: Bool[Array, "C"]) -> None:
        """Draw the chosen chunks with the bound program, culling back faces of one-sided ones."""
        GL.glBindVertexArray(self._array)
        GL.glEnable(GL.GL_CULL_FACE)
        self._draw_runs(chosen & ~self._double_sided)
        GL.glDisable(GL.GL_CULL_FACE)
        self._draw_runs(chosen & self._double_sided)

    def free(self) -> None:
        """Free the graphics memory."""
        GL.glDeleteTextures([self._texture])
        GL.glDeleteVertexArrays(1, [self._array])
        GL.glDeleteBuffers(len(self._buffers), self._buffers)

    def _draw_runs(self, chosen: Bool[Array, "C"]) -> None:
        """Draw chunks in one call, with neighbours merged into runs."""
        index = np.flatnonzero(chosen)
        if not len(index):
            return
        begin = np.flatnonzero(np.diff(index, prepend=-2) > 1)
        count = np.add.reduceat(self._count[index], begin, dtype=np.int32)
        first = self._offset[index[begin]]
        # The unwrapped call: PyOpenGL's wrapper takes no array of offsets.
        draw_runs(
            GL.GL_TRIANGLES, c_void_p(count.ctypes.data), GL.GL_UNSIGNED_INT,
            c_void_p(first.ctypes.data), len(begin),
        )  # fmt: skip


def _filled_buffer(kind: int, values: Array) -> int:
    """Create a buffer of values, left bound."""
    name = GL.glGenBuffers(1)
    GL.glBindBuffer(kind, name)
    GL.glBufferData(kind, values.nbytes, np.ascontiguousarray(values), GL.GL_STATIC_DRAW)
    return name


def texture_array(layers: Sequence[Layer]) -> int:
    """Create a texture array of layers, resized to one square size; return its OpenGL name.

    Mipmap levels are computed here by averaging four pixels: `glGenerateMipmap` of the software
    renderer takes ten times as long and brightens them. Layers are uploaded one by one to limit
    memory.
    """
    longest = max(max(layer.texture.shape[:2]) for layer in layers)
    levels = min(MAX_SIZE.bit_length(), 1 + max(longest - 1, 1).bit_length())
    name = GL.glGenTextures(1)
    GL.glActiveTexture(GL.GL_TEXTURE0)
    GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, name)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    size = 1 << (levels - 1)
    GL.glTexStorage3D(GL.GL_TEXTURE_2D_ARRAY, levels, GL.GL_RGBA8, size, size, len(layers))
    for i, layer in enumerate(layers):
        picture = _square(layer, size)
        for level in range(levels):
            side = size >> level
            if level:
                picture = cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA)
            GL.glTexSubImage3D(
                GL.GL_TEXTURE_2D_ARRAY, level, 0, 0, i, side, side, 1,
                GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, picture,
            )  # fmt: skip
    set_sampling(GL.GL_TEXTURE_2D_ARRAY, GL.GL_LINEAR_MIPMAP_NEAREST, GL.GL_LINEAR, GL.GL_REPEAT)
    return name


def _square(layer: Layer, size: int) -> UInt8[Array, "S S 4"]:
    texture = layer.texture
    if texture.shape[:2] != (size, size):
        shrinks = size < max(texture.shape[:2])
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        texture = cv2.resize(texture, (size, size), interpolation=method)
    picture = cv2.cvtColor(texture, cv2.COLOR_RGB2RGBA)
    picture[..., 3] = layer.alpha
    return picture
