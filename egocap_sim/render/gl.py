"""Headless OpenGL: the only module that imports pyrender and PyOpenGL, and creates contexts.

pyrender 0.1.45 pins PyOpenGL 3.1.0, which predates numpy 2, today's EGL and Python 3.12. Five
things must hold before pyrender is imported, so every module takes `GL` and `pyrender` from here:
`PYOPENGL_PLATFORM=egl` is set, `np.infty` exists, `OpenGL.GL.shaders` is imported before
`OpenGL.EGL`, `OpenGL.EGL` has an `EGLDeviceEXT` (mujoco's EGL requires it), and PyOpenGL knows the
name that Python 3.12 gave to the type of `ctypes.byref`. What nothing here uses takes most of
pyrender's import: its window is left out, and the libraries of its scenes, meshes, fonts and
textures are loaded when they are first used.

Mesa's software renderer uses one thread per core. With several worker processes, set
`LP_NUM_THREADS=1` in each worker's environment before it creates a context; this module does not
set it. Never fork after a context was created (the child hangs): start workers with spawn.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from egocap.errors import MachineError

REMEDY = "on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri"

os.environ["PYOPENGL_PLATFORM"] = "egl"
os.environ.setdefault("MUJOCO_GL", "egl")
np.__dict__.setdefault("infty", np.inf)


class _Later(ModuleType):
    """A module that is imported when one of its names is first used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # the import system asks
            raise AttributeError(name)
        return getattr(import_module(self.__name__), name)


@contextmanager
def _imported_later(*modules: ModuleType) -> Iterator[None]:
    """What is imported meanwhile finds these modules; imports afterwards find the real ones."""
    new = {module.__name__: module for module in modules if module.__name__ not in sys.modules}
    sys.modules.update(new)
    try:
        yield
    finally:
        for name in new:
            del sys.modules[name]


_window, _trimesh, _pillow = map(_Later, ("pyrender.viewer", "trimesh", "PIL"))
_transformations, _picture = _Later("trimesh.transformations"), _Later("PIL.Image")
_unused = (_window, _trimesh, _transformations, _pillow, _picture, _Later("networkx"),
           _Later("freetype"))  # fmt: skip
_window.__dict__["Viewer"] = None
_trimesh.__dict__["transformations"] = _transformations
_pillow.__dict__["Image"] = _picture

try:
    # isort: off
    import OpenGL
    import OpenGL.raw.EGL._errors as _egl_errors
    from OpenGL.plugins import FormatHandler

    _parameters = FormatHandler.by_name("ctypesparameter")
    assert _parameters is not None
    _parameters.check.append("_ctypes.CArgObject")
    # Errors are checked once per frame (`check_errors`): checking after each call takes longer than
    # the calls. PyOpenGL 3.1.0 then lacks the error checker of EGL. It comes after the first import
    # of a raw module on purpose: before it, released contexts cannot be made current again
    # (EGL_BAD_DISPLAY).
    OpenGL.ERROR_CHECKING = False
    _egl_errors.__dict__.setdefault("_error_checker", None)
    import OpenGL.GL as GL
    import OpenGL.GL.shaders  # before OpenGL.EGL, or PyOpenGL 3.1.0 fails
    import OpenGL.EGL as EGL
    # isort: on

    if not hasattr(EGL, "EGLDeviceEXT"):
        EGL.EGLDeviceEXT = ctypes.c_void_p  # pyright: ignore[reportAttributeAccessIssue]
    with _imported_later(*_unused):
        import pyrender
    import pyrender.renderer
    import pyrender.shader_program
    from OpenGL import contextdata
    from OpenGL.platform import PLATFORM  # type: ignore[attr-defined]
    from OpenGL.raw.GL.VERSION.GL_1_4 import glMultiDrawElements as draw_runs
    from pyrender.platforms import egl as _platform
except Exception as error:  # PyOpenGL raises AttributeError, TypeError, ImportError, OSError, ...
    raise MachineError(f"no OpenGL/EGL library could be loaded ({error})", remedy=REMEDY) from error

read_pixels = PLATFORM.GL["glReadPixels"]
"""As glReadPixels, into an address: PyOpenGL's takes three times as long as to read one pixel."""
read_pixels.argtypes = [*[ctypes.c_int] * 4, *[ctypes.c_uint] * 2, ctypes.c_void_p]
read_pixels.restype = None

_spare = threading.local()  # a context belongs to one thread

__all__ = [
    "GL", "Context", "begin_depth_test", "check_errors", "draw_runs", "make_depth_target",
    "pyrender", "read_pixels", "set_sampling",
]  # fmt: skip


class Context:
    """An OpenGL core context without a window, current in the thread that created it.

    Several may exist in one process, also at the same time (unlike pyrender's off-screen renderer,
    whose deletion ends every EGL context of the process).

    Raises: MachineError if no EGL device provides a context.
    """

    def __init__(self) -> None:
        _load_triton_first()
        self._platform = _first_working()
        self.renderer = _text(GL.GL_RENDERER)
        self.version = _text(GL.GL_VERSION)
        self.programs = pyrender.shader_program.ShaderProgramCache(
            shader_dir=str(files("egocap_sim.render") / "shaders")
        )
        """Compiled shaders, by name."""

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
        self._platform.make_current()

    def close(self) -> None:
        """Destroy the context only; the EGL display stays open for other contexts."""
        platform = getattr(self, "_platform", None)
        if platform is None:
            return
        platform.make_current()
        self.programs.clear()
        contextdata.cleanupContext()
        del self._platform
        EGL.eglMakeCurrent(
            platform._egl_display, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
        )
        EGL.eglDestroyContext(platform._egl_display, platform._egl_context)


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


def _load_triton_first() -> None:
    """Load the compiler that comes with torch for CUDA, where it is installed.

    It holds its own LLVM. Loaded after Mesa's, whose symbols are global, it ends the process by a
    segmentation fault, as soon as torch makes a layer.
    """
    found = find_spec("triton")
    for folder in found.submodule_search_locations or () if found else ():
        with suppress(OSError):
            ctypes.CDLL(str(Path(folder) / "_C" / "libtriton.so"))


def _first_working() -> _platform.EGLPlatform:
    problem: Exception | None = None
    try:
        devices = _platform.query_devices()
    except Exception:  # no device extension: use EGL's default display
        devices = [_platform.EGLDevice(None)]
    for device in devices:
        candidate = _platform.EGLPlatform(16, 16, device=device)
        try:
            candidate.init_context()
            candidate.make_current()
            _text(GL.GL_VERSION)
            return candidate
        except Exception as error:
            problem = error
    raise MachineError(
        f"none of {len(devices)} EGL devices provides an OpenGL 4.1 context ({problem!r})",
        remedy=REMEDY,
    )
