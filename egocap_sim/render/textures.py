"""Textures of one size, in one array in graphics memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
from jaxtyping import UInt8
from numpy import ndarray as Array

from egocap_sim.render.gl import GL

MAX_SIZE = 1024  # pixels along a layer
GLOW = 255  # alpha of a texture that shines by itself


@dataclass(frozen=True, eq=False)
class Layer:
    """A texture, and what all of it does with light: 0 to 200 for a highlight, or `GLOW`."""

    texture: UInt8[Array, "H W 3"]  # sRGB
    alpha: int


def texture_array(layers: Sequence[Layer]) -> int:
    """Make a texture array of layers, brought to one square size; its OpenGL name.

    The smaller levels, each pixel the mean of four, are made here: on the software renderer
    `glGenerateMipmap` takes ten times as long, and brightens them. Layer after layer goes through
    the same little memory.
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
    for key, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_NEAREST),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_REPEAT),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_REPEAT),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, key, value)
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
