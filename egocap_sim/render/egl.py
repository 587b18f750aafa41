"""EGL contexts without a window: the first device that provides OpenGL 4.1.

A display is opened by its device (EGL_EXT_platform_device), or the default one where EGL cannot
list devices. Displays stay open: closing one would end every context on it.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any

os.environ["PYOPENGL_PLATFORM"] = "egl"
os.environ.setdefault("MUJOCO_GL", "egl")

import OpenGL
import OpenGL.raw.EGL._errors as _errors

# Errors are checked once per frame (`gl.check_errors`): checking after each call takes longer than
# the calls. PyOpenGL then lacks the error checker of EGL.
OpenGL.ERROR_CHECKING = False
_errors.__dict__.setdefault("_error_checker", None)

import OpenGL.GL as GL  # noqa: E402
from OpenGL import EGL  # noqa: E402
from OpenGL.EGL.EXT.device_enumeration import eglQueryDevicesEXT  # noqa: E402
from OpenGL.EGL.EXT.platform_base import eglGetPlatformDisplayEXT  # noqa: E402

__all__ = ["GL", "EglContext", "list_devices"]

_PLATFORM_DEVICE = 0x313F  # EGL_PLATFORM_DEVICE_EXT
_MOST_DEVICES = 32
_FORMAT = (
    EGL.EGL_SURFACE_TYPE, EGL.EGL_PBUFFER_BIT, EGL.EGL_BLUE_SIZE, 8, EGL.EGL_RED_SIZE, 8,
    EGL.EGL_GREEN_SIZE, 8, EGL.EGL_DEPTH_SIZE, 24, EGL.EGL_COLOR_BUFFER_TYPE, EGL.EGL_RGB_BUFFER,
    EGL.EGL_RENDERABLE_TYPE, EGL.EGL_OPENGL_BIT, EGL.EGL_CONFORMANT, EGL.EGL_OPENGL_BIT,
    EGL.EGL_NONE,
)  # fmt: skip
_VERSION = (
    EGL.EGL_CONTEXT_MAJOR_VERSION, 4, EGL.EGL_CONTEXT_MINOR_VERSION, 1,
    EGL.EGL_CONTEXT_OPENGL_PROFILE_MASK, EGL.EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL.EGL_NONE,
)  # fmt: skip


class EglContext:
    """An OpenGL 4.1 core context of a device, made current. Raises OSError where it has none."""

    def __init__(self, device: Any) -> None:
        self._display = _display(device)
        if not EGL.eglInitialize(self._display, ctypes.c_int(), ctypes.c_int()):
            raise OSError("eglInitialize failed")
        found, configs = ctypes.c_int(), (EGL.EGLConfig * 1)()
        if not EGL.eglChooseConfig(self._display, _attributes(_FORMAT), configs, 1, found):
            raise OSError("eglChooseConfig failed")
        if not found.value or not EGL.eglBindAPI(EGL.EGL_OPENGL_API):
            raise OSError("no OpenGL configuration")
        self._context = EGL.eglCreateContext(
            self._display, configs[0], EGL.EGL_NO_CONTEXT, _attributes(_VERSION)
        )
        if not self._context:
            raise OSError("no OpenGL 4.1 core context")
        self.make_current()

    def make_current(self) -> None:
        """Make it the target of this thread's OpenGL calls. Raises OSError."""
        self._bind(self._context)

    def destroy(self) -> None:
        """Destroy the context; the display stays open for others."""
        self._bind(EGL.EGL_NO_CONTEXT)
        EGL.eglDestroyContext(self._display, self._context)

    def _bind(self, context: Any) -> None:
        none = EGL.EGL_NO_SURFACE
        if not EGL.eglMakeCurrent(self._display, none, none, context):
            raise OSError("eglMakeCurrent failed")


def list_devices() -> list[Any]:
    """The EGL devices; [None], which stands for the default display, where none are listed."""
    if not eglQueryDevicesEXT:
        return [None]
    devices, count = (EGL.EGLDeviceEXT * _MOST_DEVICES)(), ctypes.c_int()
    if not eglQueryDevicesEXT(_MOST_DEVICES, devices, count):
        return [None]
    return [devices[i] for i in range(count.value)] or [None]


def _display(device: Any) -> Any:
    if device is None:
        return EGL.eglGetDisplay(EGL.EGL_DEFAULT_DISPLAY)
    return eglGetPlatformDisplayEXT(_PLATFORM_DEVICE, device, None)


def _attributes(values: tuple[int, ...]) -> Any:
    return (ctypes.c_int * len(values))(*values)
