"""Where calibrated cameras sit on the head: after a nominal rig, or by an assumption.

A board tells how cameras stand to each other, not where the skull is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.transform import Rotation

from egocap.cameras.rig import Rig
from egocap.errors import InputError
from egocap.geometry import LEFT, rigid, unit

ASSUMED_M = (0.20, 0.0, 0.12)
"""Middle of the cameras in the head frame without a nominal rig: before and above the brow."""
ASSUMED_PITCH = np.deg2rad(60.0)
"""Mean viewing direction below horizontal without a nominal rig."""


def place_on_head(
    T_rig_view: Float[Array, "V 4 4"], names: Sequence[str], mount: Rig | None
) -> Float[Array, "4 4"]:
    """T_head_rig that brings the cameras nearest to those of `mount`, matched by name.

    Without `mount` the middle of the cameras is at `ASSUMED_M`, the line from the last to the first
    camera points left, and the mean viewing direction is `ASSUMED_PITCH` below horizontal. Raises
    InputError if the names differ.
    """
    if mount is None:
        return _assumed(T_rig_view)
    if set(mount.views) != set(names):
        raise InputError(f"the mount '{mount.name}' has the views {', '.join(mount.views)}",
                         valid=", ".join(names))  # fmt: skip
    target = mount.T_head_camera[[mount.views.index(n) for n in names]]
    turns = target[:, :3, :3] @ T_rig_view[:, :3, :3].swapaxes(1, 2)
    R = Rotation.from_matrix(turns).mean().as_matrix()
    return rigid(R, (target[:, :3, 3] - T_rig_view[:, :3, 3] @ R.T).mean(0))


def _assumed(T_rig_view: Float[Array, "V 4 4"]) -> Float[Array, "4 4"]:
    sight = unit(T_rig_view[:, :3, 2].mean(0))
    across = T_rig_view[0, :3, 3] - T_rig_view[-1, :3, 3]
    if np.linalg.norm(across) < 1e-6:
        across = -T_rig_view[0, :3, 0]  # left in the image of a single camera
    left = unit(across - sight * (across @ sight))
    ahead = np.array([np.cos(ASSUMED_PITCH), 0.0, -np.sin(ASSUMED_PITCH)])
    on_head = np.column_stack([ahead, LEFT, np.cross(ahead, LEFT)])
    R = on_head @ np.column_stack([sight, left, np.cross(sight, left)]).T
    return rigid(R, np.array(ASSUMED_M) - R @ T_rig_view[:, :3, 3].mean(0))
