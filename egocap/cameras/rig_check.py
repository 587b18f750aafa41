"""Checks of a rig: what a wearer's mistake in its file looks like. One line a finding."""

from __future__ import annotations

from itertools import combinations
from math import degrees

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.cameras.rig import Mount, Rig

FARTHEST_M = 0.8
"""Distance of a camera from the skull base beyond which no helmet carries it."""
WIDEST_M = 0.8
"""Largest distance between two cameras."""
NEAREST_M = 0.01
"""Smallest: two cameras at one place give no depth."""
SKULL = np.array([0.0, 0.0, 0.06]), np.array([0.09, 0.07, 0.10])
"""Centre and half axes [m] of the head in the head frame, an ellipsoid of an average adult's."""
NARROW_DEG = 90.0
"""Full field of view below which most of the body is out of view."""
BODY = {"hips": (-0.06, 0.0, -0.55), "feet": (0.05, 0.0, -1.55), "hands": (0.35, 0.0, -0.40)}
"""Places of the body of a standing adult in the head frame, metres."""


def check_rig(rig: Rig) -> list[str]:
    """Findings, empty for a plausible rig."""
    found = [line for mount in rig.mounts for line in _camera(mount)]
    found += _pairs(rig)
    found += _coverage(rig)
    return found


def _camera(mount: Mount) -> list[str]:
    found, place = [], mount.T_head_camera[:3, 3]
    axis = mount.T_head_camera[:3, 2]
    up = degrees(np.arcsin(np.clip(axis[2], -1.0, 1.0)))
    if up > 20.0:
        found.append(f"camera '{mount.name}' looks {up:.0f} degrees up; the body is below it "
                     "(pitch is positive downwards)")  # fmt: skip
    distance = float(np.linalg.norm(place))
    if distance > FARTHEST_M:
        found.append(f"camera '{mount.name}' is {distance:.2f} m from the skull base "
                     f"(at most {FARTHEST_M}; metres?)")  # fmt: skip
    centre, half = SKULL
    if (((place - centre) / half) ** 2).sum() < 1.0:
        found.append(f"camera '{mount.name}' is inside the head")
    cone = 2.0 * degrees(mount.camera.max_angle)
    if cone < NARROW_DEG:
        found.append(f"camera '{mount.name}' sees {cone:.0f} degrees; a body needs a fisheye lens")
    u, v = mount.camera.centre
    width, height = mount.camera.width, mount.camera.height
    if abs(u - width / 2) > width / 4 or abs(v - height / 2) > height / 4:
        found.append(f"camera '{mount.name}' has its optical axis at ({u:.0f}, {v:.0f}) of "
                     f"{width} x {height} pixels")  # fmt: skip
    return found


def _pairs(rig: Rig) -> list[str]:
    found = []
    for a, b in combinations(rig.mounts, 2):
        apart = a.T_head_camera[:3, 3] - b.T_head_camera[:3, 3]
        baseline = float(np.linalg.norm(apart))
        if baseline < NEAREST_M:
            found.append(f"cameras '{a.name}' and '{b.name}' are {1e3 * baseline:.0f} mm apart: "
                         "no depth")  # fmt: skip
        if baseline > WIDEST_M:
            found.append(f"cameras '{a.name}' and '{b.name}' are {baseline:.2f} m apart "
                         f"(at most {WIDEST_M}; metres?)")  # fmt: skip
        if {a.name, b.name} == {"left", "right"}:
            left, right = (a, b) if a.name == "left" else (b, a)
            found += _sides(left, right)
    return found


def _sides(left: Mount, right: Mount) -> list[str]:
    if left.T_head_camera[1, 3] < right.T_head_camera[1, 3]:
        return ["'left' is to the right of 'right': the pair is swapped (left is +y)"]
    rights = np.array([m.T_head_camera[:3, 0] for m in (left, right)])
    if float(rights[0] @ rights[1]) < 0.0:
        return ["the two images are turned against each other by more than 90 degrees"]
    return []


def _coverage(rig: Rig) -> list[str]:
    places: Float[Array, "P 3"] = np.array(list(BODY.values()))
    _, valid = rig.project(places)
    blind = [n for n, seen in zip(BODY, valid.any(0), strict=True) if not seen]
    return [f"no camera has the {name} of a standing wearer in view" for name in blind]
