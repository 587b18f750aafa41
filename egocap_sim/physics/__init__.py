"""Forward dynamics of the person: model, control, simulation. Import the modules directly.

mujoco is loaded here without its renderer, which is not used: with MUJOCO_GL=egl or osmesa, which
many set for other programs, its import fails on the PyOpenGL that pyrender is pinned to.
"""

import os

_asked = os.environ.get("MUJOCO_GL")
if _asked:
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco as _  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = _asked
