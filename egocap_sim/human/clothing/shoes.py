"""Shoes: closed hulls around the feet with flat soles on the floor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array
from scipy.spatial import ConvexHull, KDTree

from egocap.series import interpolate
from egocap_sim.core.bodies import INDEX
from egocap_sim.human.body.anny_model import BareBody, anatomy
from egocap_sim.human.body.skin_patch import make_patch
from egocap_sim.human.body.skinning import Worn, skinned_mesh
from egocap_sim.human.clothing.shell import skin_weights

DIRECTIONS = 28  # corners of each ring
SOLE_ROWS = 0.25  # share of the texture, at the bottom, that shows the sole


@dataclass(frozen=True)
class Shoe:
    """A shoe: collar height above the ankle joint (m) and drawn thickness of the sole (m)."""

    collar: float
    sole: float
    room: float  # m around the foot
    laced: bool = True


SHOES: dict[str, Shoe] = {
    "sneakers": Shoe(0.0, 0.026, 0.007),
    "loafers": Shoe(-0.012, 0.016, 0.004, laced=False),
    "high_tops": Shoe(0.05, 0.024, 0.008),
    "boots": Shoe(0.09, 0.030, 0.010),
}


def make_shoes(body: BareBody, shoe: Shoe, texture: UInt8[Array, "H W 3"]) -> Worn:
    """Both shoes as one mesh.

    The ring at each level is the outline, seen from above, of the foot at or above that level, so
    that it encloses the foot. The lowest point of foot and sole is on the floor: the thickness of
    the sole is only a texture.
    """
    owner, z = anatomy().owner, body.vertices[:, 2]
    vertices, faces, uv = [], [], []
    covered = np.zeros(len(z), bool)
    for side in ("l_", "r_"):
        top = body.joints[INDEX[side + "foot"], 2] + shoe.collar
        leg = np.isin(owner, [INDEX[side + b] for b in ("calf", "foot", "toe")])
        foot = leg & (z < top + 0.035)
        covered |= foot & (z < top - 0.025)
        points, places = _rings(body.vertices[foot], top, shoe)
        faces.append(_ring_faces(len(points)) + sum(map(len, vertices)))
        vertices.append(points.reshape(-1, 3))
        uv.append(places.reshape(-1, 2))
    parts = np.concatenate(vertices), np.concatenate(faces), np.concatenate(uv)
    return Worn(
        skinned_mesh("shoes", *parts, texture, _weights_near(body, parts[0]), 0.15), covered
    )


def shoe_texture(
    upper: UInt8[Array, "N N 3"], sole: Float[Array, "3"], laced: bool = True
) -> UInt8[Array, "H W 3"]:
    """The upper's fabric, stitched, above a plain band for the sole.

    Columns run from the heel to the tip, rows from the collar down.
    """
    image = np.tile(upper, (4, 4, 1))
    n = len(image)
    rows = round(n * SOLE_ROWS)
    for place in (0.17, 0.80):  # heel counter and toe cap
        column = slice(round(place * n), round(place * n) + 4)
        image[:, column] = np.rint(0.6 * image[:, column])
    lace = 225 if upper.mean() < 150 else 70
    for place in np.linspace(0.50, 0.70, 6) if laced else ():
        image[n // 12 : n // 3, round(place * n) : round(place * n) + 7] = lace
    image[-rows:] = np.rint(sole * 255)
    image[-rows : -rows + 6] = np.rint(sole * 160)
    return image


def _rings(
    foot: Float[Array, "N 3"], top: float, shoe: Shoe
) -> tuple[Float[Array, "L D 3"], Float[Array, "L D 2"]]:
    """Rings from the centre of the sole, around the foot, to the folded collar; and their uv."""
    base, sole, edge = _outline(foot, 0.0, shoe.room + 0.004), shoe.sole, 1 - SOLE_ROWS
    middle = base.mean(0)
    rings = [  # outline, height (m), row of the texture
        (middle + 0.02 * (base - middle), 0.0, 0.999),
        (middle + 0.97 * (base - middle), 0.0, 0.97),
        (base, 0.004, 0.94),
        (base, sole, edge + 0.01),
        (middle + 0.975 * (base - middle), sole + 0.001, edge - 0.01),
    ]
    for z in np.linspace(sole + 0.012, top, 7):
        share = (z - sole) / (top - sole)
        rings.append((_outline(foot, z - 0.012, shoe.room), z, (1 - share) * (edge - 0.02)))
    collar = rings[-1][0]
    rings.append((collar.mean(0) + 0.88 * (collar - collar.mean(0)), top - 0.004, 0.0))
    points = np.array([np.column_stack([xy, np.full(DIRECTIONS, z)]) for xy, z, _ in rings])
    heel, tip = foot[:, 0].min(), foot[:, 0].max()
    u = (points[..., 0] - heel) / (tip - heel)
    v = np.array([row for _, _, row in rings])
    return points, np.stack([u, np.broadcast_to(v[:, None], u.shape)], 2)


def _outline(foot: Float[Array, "N 3"], z: float, room: float) -> Float[Array, "D 2"]:
    """Convex outline of the foot above a level, rounded outward by `room` (m), evenly spaced."""
    points = foot[foot[:, 2] >= z, :2]
    corners = points[ConvexHull(points).vertices]
    angle = 2 * np.pi * np.arange(16) / 16
    circle = room * np.stack([np.cos(angle), np.sin(angle)], 1)
    rounded = (corners[:, None] + circle).reshape(-1, 2)
    loop = rounded[ConvexHull(rounded).vertices]
    # Rings start at the heel, so that their corners correspond.
    loop = np.roll(loop, -int(loop[:, 0].argmin()), 0)
    closed = np.concatenate([loop, loop[:1]])
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = travelled[-1] * np.arange(DIRECTIONS) / DIRECTIONS
    return interpolate(at, travelled, closed)


def _ring_faces(count: int) -> Int[Array, "F 3"]:
    """Triangles between closed rings stacked upward, each counter-clockwise seen from above."""
    ring = np.arange(DIRECTIONS)
    a = ring + DIRECTIONS * np.arange(count - 1)[:, None]
    after = np.roll(ring, -1) - ring
    b = a + DIRECTIONS
    first, second = np.stack([a, a + after, b + after], -1), np.stack([a, b + after, b], -1)
    return np.stack([first, second], 1).reshape(-1, 3)


def _weights_near(body: BareBody, points: Float[Array, "M 3"]) -> Float[Array, "M 21"]:
    """Mean skin weights of the nearest skin on the same leg."""
    weights, low = _smooth_weights(), body.vertices[:, 2] < body.joints[INDEX["l_calf"], 2]
    result = np.zeros((len(points), weights.shape[1]))
    for sign in (1, -1):
        mine, skin = sign * points[:, 1] > 0, low & (sign * body.vertices[:, 1] > 0)
        _, near = KDTree(body.vertices[skin]).query(points[mine], k=12)
        result[mine] = weights[skin][near].mean(1)
    return result


@cache
def _smooth_weights() -> Float[Array, "N 21"]:
    """Smoothed skin weights, so that shoes bend less sharply."""
    weights = skin_weights()
    return make_patch(np.ones(len(weights), bool)).smoothed(weights, 4)
