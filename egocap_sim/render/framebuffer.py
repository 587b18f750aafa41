"""Framebuffers of the atlas: colour, labels and depth."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from egocap.errors import MachineError
from egocap_sim.render.gl import GL, begin_depth_test, make_depth_target, read_pixels

Window = tuple[int, int, int, int]  # column, row, width, height in the atlas


class AtlasBuffer:
    """Colour with labels in alpha, and depth; with `samples`, multisampled and resolved on reading.

    Resolving would mix labels, so with `samples` they are drawn again on demand, not multisampled.
    """

    def __init__(self, needed: Bool[Array, "h w"], samples: int) -> None:
        most = int(GL.glGetIntegerv(GL.GL_MAX_SAMPLES))
        if samples > most:
            raise MachineError(f"{samples} samples; OpenGL takes {most} at most on this machine "
                               "(valid: fewer --samples, or 'samples' of [record])")  # fmt: skip
        self.height, self.width = needed.shape
        self.samples = samples
        self._renderbuffers: list[int] = []
        self._plain = self._make(0)
        self._drawn = self._make(samples) if samples else self._plain
        self.color, self._before = np.empty((2, self.height, self.width, 4), np.uint8)
        self.labels = np.empty((self.height, self.width), np.uint8)
        self.has_labels = False
        # Initial depth: far, but nearest where no pixel needs to be drawn, which culls everything.
        empty = needed.astype(np.float32)
        self._texture, self._empty_depth = make_depth_target(self.width, self.height, empty)

    def begin(self, background: Float[Array, "3"], windows: Sequence[Window]) -> None:
        """Clear and bind for drawing in windows; background colour as written to pixels, 0..1."""
        self.has_labels = False
        self._start(self._drawn, background, windows)
        (GL.glEnable if self.samples else GL.glDisable)(GL.GL_MULTISAMPLE)

    def end(self) -> None:
        """End drawing; resolve the samples if there are any."""
        GL.glDisable(GL.GL_SCISSOR_TEST)
        if self.samples:
            box = (0, 0, self.width, self.height)
            GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._drawn)
            GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._plain)
            GL.glBlitFramebuffer(*box, *box, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._plain)

    def begin_labels(self) -> None:
        """Bind for drawing labels and depth over the resolved colours; read those first."""
        self._start(self._plain, np.zeros(3), [(0, 0, self.width, self.height)])

    def take_labels(self) -> None:
        """Extract the labels from the alpha of the colours read; needs `samples` of 0."""
        cv2.extractChannel(self.color, 3, self.labels)
        self.has_labels = True

    def end_labels(self) -> None:
        """End drawing labels, and read them."""
        GL.glDisable(GL.GL_SCISSOR_TEST)
        self._read(self.labels, GL.GL_ALPHA, GL.GL_UNSIGNED_BYTE)
        self.has_labels = True

    def read_color(self) -> Array:
        """The atlas (h, w, 4), bottom row first; overwritten by the next frame but one."""
        self.color, self._before = self._before, self.color
        self._read(self.color, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE)
        return self.color

    def read_depth(self) -> Float[Array, "h w"]:
        """Depth buffer values 0..1 of the atlas."""
        depth = np.empty((self.height, self.width), np.float32)
        self._read(depth, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        return depth

    def read_depth_at(self, at: Int[Array, "N 2"]) -> Float[Array, "N"]:
        """Depth buffer values 0..1 at atlas pixels (column, row)."""
        depth = np.empty(len(at), np.float32)
        place, kind = depth.ctypes.data, (GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._plain)
        for i, (column, row) in enumerate(at.tolist()):
            read_pixels(column, row, 1, 1, *kind, place + depth.itemsize * i)
        return depth

    def free(self) -> None:
        """Free the graphics memory."""
        frames = {self._plain, self._drawn, self._empty_depth}
        GL.glDeleteTextures([self._texture])
        GL.glDeleteFramebuffers(len(frames), list(frames))
        GL.glDeleteRenderbuffers(len(self._renderbuffers), self._renderbuffers)

    def _read(self, out: Array, kind: int, dtype: int) -> None:
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._plain)
        GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
        GL.glReadPixels(0, 0, self.width, self.height, kind, dtype, out)

    def _start(self, frame: int, background: Array, windows: Sequence[Window]) -> None:
        begin_depth_test(frame)
        GL.glDisable(GL.GL_BLEND)
        # Depth first: the driver defers clearing colour to the drawing, unless a copy follows.
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._empty_depth)
        for column, row, width, height in windows:
            box = (column, row, column + width, row + height)
            GL.glBlitFramebuffer(*box, *box, GL.GL_DEPTH_BUFFER_BIT, GL.GL_NEAREST)
        red, green, blue = map(float, background)
        GL.glClearColor(red, green, blue, 0.0)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT)
        GL.glEnable(GL.GL_SCISSOR_TEST)

    def _make(self, samples: int) -> int:
        frame = GL.glGenFramebuffers(1)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
        for kind, place in (
            (GL.GL_RGBA8, GL.GL_COLOR_ATTACHMENT0),
            (GL.GL_DEPTH_COMPONENT24, GL.GL_DEPTH_ATTACHMENT),
        ):
            buffer = GL.glGenRenderbuffers(1)
            self._renderbuffers.append(buffer)
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            size = (self.width, self.height)
            if samples:
                GL.glRenderbufferStorageMultisample(GL.GL_RENDERBUFFER, samples, kind, *size)
            else:
                GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, kind, *size)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, place, GL.GL_RENDERBUFFER, buffer)
        status = GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER)
        assert status == GL.GL_FRAMEBUFFER_COMPLETE, f"framebuffer status {status:#x}"
        return frame
