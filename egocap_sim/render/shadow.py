"""Shadow maps: depth from the light; sharp for the sun, soft for lamps and windows.

A sharp map is compared while it is sampled. A soft one stores the mean of depth and of its square
over the width of the light's penumbra; Chebyshev's inequality bounds the light on a surface behind
the mean. Shadows of casters close to the ground are sharper.

Source: Donnelly & Lauritzen 2006, "Variance shadow maps"; penumbrae by distance after Fernando
2005, "Percentage-closer soft shadows", with the ground as the receiver.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import c_void_p

import cv2
import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray as Array

from egocap_sim.render import projection
from egocap_sim.render.gl import GL, begin_depth_test, make_depth_target, set_sampling

GAPS_M = (0.5, 1.6)  # caster distances from the ground, along the light, with their own blur;
# the penumbra does not widen beyond
_GAP = np.float32(1e-3)  # of the depth range: least distance of a caster from the ground
SOFT = 0.03  # least tangent of a light's diameter for soft shadows; the sun's: 0.009


class ShadowMap:
    """Depth from the light, compared while it is sampled (four neighbours blended)."""

    defines: Mapping[str, int] = {}  # of the shader that samples it

    def __init__(self, size: int) -> None:
        self.size = size
        self._texture, self._frame = make_depth_target(size, size)
        self._sampled = self._texture  # by shaders
        _set_sampling()
        for key, value in (
            (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
            (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL),
        ):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)

    def begin(self) -> None:
        """Clear and bind for drawing."""
        begin_depth_test(self._frame)
        GL.glViewport(0, 0, self.size, self.size)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        GL.glEnable(GL.GL_DEPTH_CLAMP)  # keeps casters behind the light
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glPolygonOffset(1.5, 2.0)

    def end(self, clip: Float[Array, "4 4"]) -> None:
        """End drawing, which was through `clip`, the clip-from-world matrix."""
        GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glDisable(GL.GL_DEPTH_CLAMP)

    def bind(self, unit: int) -> None:
        """Bind the texture to a texture unit."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)  # pyright: ignore[reportOperatorIssue]
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._sampled)

    def free(self) -> None:
        """Free the graphics memory."""
        GL.glDeleteFramebuffers(1, [self._frame])
        GL.glDeleteTextures([self._texture])


class SoftShadowMap(ShadowMap):
    """Shadow map of a light whose diameter is `spread` times its distance."""

    defines = {"SOFT_SHADOWS": 1}

    def __init__(self, size: int, spread: float) -> None:
        super().__init__(size)
        texel = 2.0 * projection.SHADOW_HALF_WIDTH / size
        self._widths = [2 * round(spread * gap / texel / 2) + 1 for gap in GAPS_M]  # pixels
        self._depth = np.empty((size, size), np.float32)
        self._moments = self._sampled = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._moments)
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_RG32F, size, size, 0, GL.GL_RG, GL.GL_FLOAT, c_void_p(0)
        )
        _set_sampling()

    def end(self, clip: Float[Array, "4 4"]) -> None:
        """End drawing, and blur."""
        super().end(clip)
        size = self.size
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._frame)
        GL.glReadPixels(0, 0, size, size, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, array=self._depth)
        sharp = depth_moments(self._depth, projection.ground_depth(clip, size))
        half, wide = (
            cv2.blur(sharp, (n, n), borderType=cv2.BORDER_REPLICATE) for n in self._widths
        )
        gaps = np.array(GAPS_M, np.float32) / np.float32(projection.SHADOW_DEPTH)
        moments = soften(sharp, half, wide, gaps)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._moments)
        GL.glTexSubImage2D(GL.GL_TEXTURE_2D, 0, 0, 0, size, size, GL.GL_RG, GL.GL_FLOAT, moments)

    def free(self) -> None:
        """Free the graphics memory."""
        super().free()
        GL.glDeleteTextures([self._moments])


def shadow_map(spread: float, fine: bool) -> ShadowMap:
    """The map for a light's spread; `fine` for images of more than about 800 pixels."""
    if spread < SOFT:
        return ShadowMap(1024 if fine else 640)
    return SoftShadowMap(640 if fine else 400, spread)


def _set_sampling() -> None:
    """Interpolate the bound texture; everything beyond its border is lit."""
    set_sampling(GL.GL_TEXTURE_2D, GL.GL_LINEAR, GL.GL_LINEAR, GL.GL_CLAMP_TO_BORDER)
    GL.glTexParameterfv(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))


@njit(cache=True, error_model="numpy")
def depth_moments(depth: Float[Array, "S S"], ground: Float[Array, "3"]) -> Float[Array, "S S 4"]:
    """Depth, its square, the distance of a caster from the ground, and whether there is one.

    The ground's depth is ground[0] + ground[1] * column + ground[2] * row; depth is clamped to it.
    """
    size = len(depth)
    out = np.empty((size, size, 4), np.float32)
    for row in range(size):
        for column in range(size):
            floor = ground[0] + ground[1] * np.float32(column) + ground[2] * np.float32(row)
            d = min(depth[row, column], floor)
            casts = floor - d > _GAP
            out[row, column, 0] = d
            out[row, column, 1] = d * d
            out[row, column, 2] = floor - d if casts else np.float32(0.0)
            out[row, column, 3] = np.float32(1.0) if casts else np.float32(0.0)
    return out


@njit(cache=True, error_model="numpy")
def soften(
    sharp: Float[Array, "S S 4"],
    half: Float[Array, "S S 4"],
    wide: Float[Array, "S S 4"],
    gaps: Float[Array, "2"],
) -> Float[Array, "S S 2"]:
    """Depth and its square, blurred by the mean distance of nearby casters from the ground.

    `half` and `wide` are means over the penumbrae of casters at the `gaps`; the result is
    interpolated between them and `sharp`.
    """
    size, zero, one = len(sharp), np.float32(0.0), np.float32(1.0)
    out = np.empty((size, size, 2), np.float32)
    for row in range(size):
        for column in range(size):
            casters = wide[row, column, 3]
            gap = wide[row, column, 2] / casters if casters > np.float32(1e-6) else zero
            some = min(gap / gaps[0], one)
            more = min(max((gap - gaps[0]) / (gaps[1] - gaps[0]), zero), one)
            for k in range(2):
                d = sharp[row, column, k]
                d += some * (half[row, column, k] - d)
                out[row, column, k] = d + more * (wide[row, column, k] - d)
    return out
