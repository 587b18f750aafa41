"""Batches in graphics memory, texture arrays, and shader uniforms by name."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_void_p

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap_sim.render.batch import Batch, Layer
from egocap_sim.render.gl import GL, draw_runs, pyrender, set_sampling

MAX_SIZE = 1024  # pixels along a texture


class GpuBatch:
    """Vertex buffer (a pyrender primitive), index buffer and texture array of one batch."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.primitive = pyrender.Primitive(
            positions=batch.positions,
            normals=batch.normals,
            texcoord_0=batch.uv,
            texcoord_1=batch.layer_part,
            indices=batch.faces,
        )
        self.mesh = pyrender.Mesh([self.primitive])
        self._vertices = np.concatenate(
            [batch.positions, batch.normals, batch.uv, batch.layer_part], axis=1
        ).astype(np.float32)
        self._texture = texture_array(batch.layers)
        self._double_sided = np.array([c.double_sided for c in batch.chunks])
        self.casts_shadow = np.array([c.casts_shadow for c in batch.chunks])
        self._offset = np.array([4 * c.first for c in batch.chunks], np.uintp)  # bytes
        self._count = np.array([c.count for c in batch.chunks])

    def upload(self, positions: Float[Array, "N 3"], normals: Float[Array, "N 3"]) -> None:
        """Upload posed vertices and normals."""
        self._vertices[:, :3], self._vertices[:, 3:6] = positions, normals
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self.primitive._buffers[0])
        GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, self._vertices.nbytes, self._vertices)

    def bind_textures(self, unit: int) -> None:
        """Bind the texture array to a texture unit."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)  # pyright: ignore[reportOperatorIssue]
        GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, self._texture)

    def draw(self, chosen: Bool[Array, "C"]) -> None:
        """Draw the chosen chunks with the bound program, culling back faces of one-sided ones."""
        self.primitive._bind()
        GL.glEnable(GL.GL_CULL_FACE)
        self._draw_runs(chosen & ~self._double_sided)
        GL.glDisable(GL.GL_CULL_FACE)
        self._draw_runs(chosen & self._double_sided)

    def free(self) -> None:
        """Free the texture memory; the renderer frees the buffers."""
        GL.glDeleteTextures([self._texture])

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


class Uniforms:
    """Set shader uniforms by name with cached locations.

    pyrender's `set_uniform` looks up the name each time and ignores errors.
    """

    def __init__(self) -> None:
        self._location: dict[tuple[int, str], int] = {}

    def matrix(self, program, name: str, value: Float[Array, "4 4"]) -> None:
        """A 4x4 matrix."""
        GL.glUniformMatrix4fv(self._locate(program, name), 1, GL.GL_TRUE, value.astype(np.float32))

    def vector(self, program, name: str, value: Float[Array, "3"]) -> None:
        """Three numbers."""
        GL.glUniform3f(self._locate(program, name), *map(float, value))

    def _locate(self, program, name: str) -> int:
        key = (program._program_id, name)
        if key not in self._location:
            location = GL.glGetUniformLocation(*key)
            assert location >= 0, f"shader has no active input '{name}'"
            self._location[key] = location
        return self._location[key]


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
