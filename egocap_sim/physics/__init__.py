"""A person and a reference motion in; a simulated trajectory with contact forces out.

mujoco is imported here without its unused renderer: with MUJOCO_GL=egl or osmesa that import fails
with the PyOpenGL version that pyrender is pinned to. Import the modules directly.
"""

import os

_asked = os.environ.get("MUJOCO_GL")
if _asked:
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco as _  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = _asked
