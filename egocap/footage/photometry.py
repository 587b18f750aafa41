"""Colours of views brought together: the gains between what they show of the same surroundings.

Each view's colours are medians over the directions that all views see, without the wearer: they
move with gain, and neither bright windows nor the place of an object decides them. The gain of a
view is the median ratio to the first view's colours over pictures taken at the same time. A change
of exposure or white balance multiplies linear light, hence recorded values as well where these are
a power of it.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.cameras.rig import Rig
from egocap.data.footage import ViewColour
from egocap.footage.head_rotation import background
from egocap.series import interpolate

SIZE = (80, 64)  # of reduced pictures, px
LEAST = 0.02  # of a reduced picture that all views must see
DARK, BRIGHT = 8.0, 247.0  # medians beyond are too dark or saturated
MOST = 2.5  # a larger gain is no correction any more


def shared_surroundings(rig: Rig) -> list[Bool[Array, "64 80"]]:
    """Pixels of each view's reduced pictures whose direction all views see, without the wearer."""
    masks = []
    for mount in rig.mounts:
        camera = mount.camera.resized(*SIZE)
        seen, rays = background(camera, mount.T_head_camera[:3, :3])
        for other in rig.mounts:
            local = rays @ other.T_head_camera[:3, :3]
            seen = seen & other.camera.project(local)[1]
        masks.append(seen)
    return masks


def median_colour(
    small: UInt8[Array, "64 80 3"], mask: Bool[Array, "64 80"]
) -> Float[Array, "3"]:  # fmt: skip
    """Median red, green and blue of the masked pixels; nan where these are too few."""
    if mask.mean() < LEAST:
        return np.full(3, np.nan)
    return np.median(small[mask], axis=0)


def estimate_colour(
    first_time: Float[Array, "N"],
    first: Float[Array, "N 3"],
    time: Float[Array, "M"],
    colour: Float[Array, "M 3"],
) -> ViewColour:
    """Gains that bring a view's colours to the first's; times by the common clock.

    Unchanged where the views have no usable pictures at the same time.
    """
    own = _usable(colour)
    known = _usable(first)
    if known.sum() < 2 or not own.any():
        return ViewColour()
    inside = own & (time >= first_time[known][0]) & (time <= first_time[known][-1])
    if not inside.any():
        return ViewColour()
    wanted = interpolate(time[inside], first_time[known], first[known])
    gain = np.median(wanted / colour[inside], axis=0).clip(1.0 / MOST, MOST)
    return ViewColour(gain=tuple(map(float, gain)), origin="estimated")  # pyright: ignore


def _usable(colour: Float[Array, "N 3"]) -> Bool[Array, "N"]:
    return np.asarray(((colour > DARK) & (colour < BRIGHT)).all(1))
