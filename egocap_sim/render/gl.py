"""Headless OpenGL: contexts, and the names of PyOpenGL that the renderer uses.

Every module takes `GL` from here: `egl` prepares PyOpenGL before its first import.

Mesa's software renderer uses one thread per core. With several worker processes, set
`LP_NUM_THREADS=1` in each worker's environment before it creates a context; this module does not
set it. Never fork after a context was created (the child hangs): start workers with spawn.
"""

from __future__ import annotations

import ctypes
import threading

import numpy as np

from egocap.errors import MachineError

REMEDY = "on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri"

try:
    # isort: off
    from egocap_sim.render.egl import GL, EglContext, list_devices  # before anything of OpenGL
    from OpenGL import contextdata
    from OpenGL.raw.GL.VERSION.GL_1_0 import glReadPixels as read_pixels
    from OpenGL.raw.GL.VERSION.GL_1_4 import glMultiDrawElements as draw_runs
    from egocap_sim.render.programs import Programs
    # isort: on
except Exception as error:  # PyOpenGL raises AttributeError, TypeError, ImportError, OSError, ...
    raise MachineError(f"no OpenGL/EGL library could be loaded ({error})", remedy=REMEDY) from error

_spare = threading.local()  # a context belongs to one thread

__all__ = [
    "GL", "Context", "begin_depth_test", "check_errors", "draw_runs", "make_depth_target",
    "read_pixels", "set_sampling",
]  # fmt: skip


class Context:
    """An OpenGL core context without a window, current in the thread that created it.

    Several may exist in one process, also at the same time.

    Raises: MachineError if no EGL device provides a context.
    """

    def __init__(self) -> None:
        self._egl: EglContext | None = _first_working()
        self.renderer = _text(GL.GL_RENDERER)
        self.version = _text(GL.GL_VERSION)
        self.programs = Programs()
        """Compiled shaders, kept with the context for its next renderer."""

    @classmethod
    def borrow(cls) -> Context:
        """The context that this thread released last, with compiled shaders, or a new one."""
        context: Context | None = _spare.__dict__.pop("context", None)
        if context is None:
            return cls()
        context.make_current()
        return context

    def release(self) -> None:
        """Keep it for the thread's next `borrow`; its buffers and textures must have been freed."""
        if "context" in _spare.__dict__ or GL.glGetError():
            self.close()
        else:
            _spare.context = self

    def make_current(self) -> None:
        """Make it the target of this thread's OpenGL calls."""
        assert self._egl is not None, "the context is closed"
        self._egl.make_current()

    def close(self) -> None:
        """Destroy the context only; the EGL display stays open for other contexts."""
        if self._egl is None:
            return
        self._egl.make_current()
        self.programs.delete()
        contextdata.cleanupContext()
        self._egl.destroy()
        self._egl = None


def check_errors() -> None:
    """Raise MachineError for an OpenGL error since the last check."""
    if error := GL.glGetError():
        raise MachineError(f"OpenGL reports error {error:#x}, possibly out of memory")


def set_sampling(target: int, minify: int, magnify: int, wrap: int) -> None:
    """Set filters and wrapping of the texture bound to `target`."""
    GL.glTexParameteri(target, GL.GL_TEXTURE_MIN_FILTER, minify)
    GL.glTexParameteri(target, GL.GL_TEXTURE_MAG_FILTER, magnify)
    GL.glTexParameteri(target, GL.GL_TEXTURE_WRAP_S, wrap)
    GL.glTexParameteri(target, GL.GL_TEXTURE_WRAP_T, wrap)


def begin_depth_test(frame: int) -> None:
    """Bind a framebuffer and set up the depth test and back-face culling."""
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
    GL.glDisable(GL.GL_SCISSOR_TEST)
    GL.glEnable(GL.GL_DEPTH_TEST)
    GL.glDepthMask(GL.GL_TRUE)
    GL.glDepthFunc(GL.GL_LESS)
    GL.glCullFace(GL.GL_BACK)


def make_depth_target(width: int, height: int, values: np.ndarray | None = None) -> tuple[int, int]:
    """Create a depth texture, left bound, and a framebuffer with it alone."""
    texture = GL.glGenTextures(1)
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexImage2D(
        GL.GL_TEXTURE_2D, 0, GL.GL_DEPTH_COMPONENT24, width, height, 0,
        GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, ctypes.c_void_p(0) if values is None else values,
    )  # fmt: skip
    frame = GL.glGenFramebuffers(1)
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, frame)
    GL.glFramebufferTexture2D(
        GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, texture, 0
    )
    GL.glDrawBuffer(GL.GL_NONE)
    GL.glReadBuffer(GL.GL_NONE)
    return texture, frame


def _text(name: int) -> str:
    return GL.glGetString(name).decode()  # pyright: ignore[reportAttributeAccessIssue]


def _first_working() -> EglContext:
    problem: Exception | None = None
    devices = list_devices()
    for device in devices:
        try:
            context = EglContext(device)
            _text(GL.GL_VERSION)
            return context
        except Exception as error:  # each driver fails in its own way
            problem = error
    raise MachineError(
        f"none of {len(devices)} EGL devices provides an OpenGL 4.1 context ({problem!r})",
        remedy=REMEDY,
    )
