"""A tracked motion in the world in; the motion of a simulated body, and the forces on it, out.

Edit here the body with the tracker's skeleton, the forces that move it, and what is reported.
"""

import egocap_sim.physics  # noqa: F401 (imports mujoco without its renderer)
