"""A person and a reference motion in; a simulated trajectory with contact forces out.

mujoco is imported here without its unused renderer: with MUJOCO_GL=egl or osmesa that import fails
with the PyOpenGL version that pyrender is pinned to, and otherwise it starts a process to look for
a library of windows. Import the modules directly.
"""

import os

_asked = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
try:
    import mujoco as _  # noqa: F401
finally:
    if _asked is None:
        del os.environ["MUJOCO_GL"]
    else:
        os.environ["MUJOCO_GL"] = _asked
