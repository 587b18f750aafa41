"""Shadow maps: depth from the light; sharp for the sun, soft for lamps and windows.

A sharp map is compared while it is looked up. A soft one keeps the mean of depth and of its square
over a square as wide as the light's penumbra: a surface behind the mean is lit by at most the share
that Chebyshev's inequality leaves. Where a caster stands near the ground, its shadow is sharper.

Source: Donnelly & Lauritzen 2006, "Variance shadow maps"; penumbrae by distance after Fernando
2005, "Percentage-closer soft shadows", with the ground as the receiver.
"""

from __future__ import annotations

from collections.abc import Mapping
from ctypes import c_void_p

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.render import projection
from egocap_sim.render.gl import GL
from egocap_sim.render.shadow_kernel import moments_of, softened

GAPS_M = (0.5, 1.6)  # casters' distances from the ground, along the light, that are blurred for;
# farther ones throw no wider penumbra
SOFT = 0.03  # tangent of a light's diameter from which its shadows are drawn soft; the sun's: 0.009


class ShadowMap:
    """Depth from the light, compared while it is sampled (four neighbours blended)."""

    defines: Mapping[str, int] = {}  # of the shader that reads it

    def __init__(self, size: int) -> None:
        self.size = size
        self._texture = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texture)
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_DEPTH_COMPONENT24, size, size, 0,
            GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, c_void_p(0),
        )  # fmt: skip
        _look_up()
        for key, value in (
            (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
            (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL),
        ):
            GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)
        self._frame = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glFramebufferTexture2D(
            GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, self._texture, 0
        )
        GL.glDrawBuffer(GL.GL_NONE)
        GL.glReadBuffer(GL.GL_NONE)

    def begin(self) -> None:
        """Clear and draw here."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._frame)
        GL.glDisable(GL.GL_SCISSOR_TEST)
        GL.glViewport(0, 0, self.size, self.size)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glDepthMask(GL.GL_TRUE)
        GL.glDepthFunc(GL.GL_LESS)
        GL.glCullFace(GL.GL_BACK)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        GL.glEnable(GL.GL_DEPTH_CLAMP)  # casters behind the light still cast
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glPolygonOffset(1.5, 2.0)

    def end(self, clip: Float[Array, "4 4"]) -> None:
        """Stop drawing, which was through `clip`, from the world."""
        GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glDisable(GL.GL_DEPTH_CLAMP)

    def bind(self, unit: int) -> None:
        """Make it readable by shaders."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)  # pyright: ignore[reportOperatorIssue]
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texture)

    def free(self) -> None:
        """Give the memory back."""
        GL.glDeleteFramebuffers(1, [self._frame])
        GL.glDeleteTextures([self._texture])


class SoftShadowMap(ShadowMap):
    """The shadows of a light whose diameter is `spread` times its distance."""

    defines = {"SOFT_SHADOWS": 1}

    def __init__(self, size: int, spread: float) -> None:
        super().__init__(size)
        texel = 2.0 * projection.SHADOW_HALF_WIDTH / size
        self._widths = [2 * round(spread * gap / texel / 2) + 1 for gap in GAPS_M]  # pixels
        self._depth = np.empty((size, size), np.float32)
        self._moments = GL.glGenTextures(1)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._moments)
        GL.glTexImage2D(
            GL.GL_TEXTURE_2D, 0, GL.GL_RG32F, size, size, 0, GL.GL_RG, GL.GL_FLOAT, c_void_p(0)
        )
        _look_up()

    def end(self, clip: Float[Array, "4 4"]) -> None:
        """Stop drawing, and blur."""
        super().end(clip)
        size = self.size
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._frame)
        GL.glReadPixels(0, 0, size, size, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, array=self._depth)
        sharp = moments_of(self._depth, projection.ground_depth(clip, size))
        half, wide = (
            cv2.blur(sharp, (n, n), borderType=cv2.BORDER_REPLICATE) for n in self._widths
        )
        gaps = np.array(GAPS_M, np.float32) / np.float32(projection.SHADOW_DEPTH)
        moments = softened(sharp, half, wide, gaps)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._moments)
        GL.glTexSubImage2D(GL.GL_TEXTURE_2D, 0, 0, 0, size, size, GL.GL_RG, GL.GL_FLOAT, moments)

    def bind(self, unit: int) -> None:
        """Make it readable by shaders."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + unit)  # pyright: ignore[reportOperatorIssue]
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._moments)

    def free(self) -> None:
        """Give the memory back."""
        super().free()
        GL.glDeleteTextures([self._moments])


def shadow_map(spread: float, fine: bool) -> ShadowMap:
    """The map for a light's spread; `fine` for images of more than some 800 pixels."""
    if spread < SOFT:
        return ShadowMap(1024 if fine else 640)
    return SoftShadowMap(640 if fine else 400, spread)


def _look_up() -> None:
    """How the bound texture is looked up: blended; beyond its border everything is lit."""
    for key, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_BORDER),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_BORDER),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, value)
    GL.glTexParameterfv(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_BORDER_COLOR, np.ones(4, np.float32))
