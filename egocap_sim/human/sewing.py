"""Lay fabric on cloth: texture coordinates around the torso and the limbs, and the drawn mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array

from egocap.geometry import unit
from egocap_sim.bodies import INDEX
from egocap_sim.human.anny_model import BareBody
from egocap_sim.human.chart import LEFT_ARM, LEFT_LEG, RIGHT_ARM, RIGHT_LEG, TORSO
from egocap_sim.human.shell import Shell
from egocap_sim.human.skin import PART_OF_BODY
from egocap_sim.mesh import Mesh

GIRTH = {TORSO: 0.96, LEFT_ARM: 0.30, RIGHT_ARM: 0.30, LEFT_LEG: 0.48, RIGHT_LEG: 0.48}  # m
LIMBS = {
    LEFT_ARM: ("l_upperarm", "l_forearm", "l_hand"),
    RIGHT_ARM: ("r_upperarm", "r_forearm", "r_hand"),
    LEFT_LEG: ("l_thigh", "l_calf", "l_foot"),
    RIGHT_LEG: ("r_thigh", "r_calf", "r_foot"),
}


def sew(
    name: str,
    shell: Shell,
    body: BareBody,
    texture: UInt8[Array, "H W 3"],
    tile_m: float,
    shininess: float = 0.0,
) -> Mesh:
    """Make the mesh of a shell whose texture repeats about every `tile_m` metres.

    Around a limb the texture repeats a whole number of times, so that no seam shows; vertices are
    doubled where two pieces of cloth meet and at the back of each.
    """
    corner_piece = np.repeat(shell.piece[shell.faces].max(1), 3)
    corner_vertex = shell.faces.ravel()
    turn, along = np.zeros(len(corner_vertex)), np.zeros(len(corner_vertex))
    for piece in GIRTH:
        here = corner_piece == piece
        turn[here], along[here] = _unroll(piece, shell.vertices[corner_vertex[here]], body)
    turn = turn.reshape(-1, 3)
    turn = turn + ((turn.max(1, keepdims=True) - turn) > 0.5)  # triangles across the back
    repeats = np.array([max(1, round(GIRTH[p] / tile_m)) for p in sorted(GIRTH)])[corner_piece]
    u, v = turn.ravel() * repeats, -along / tile_m
    key = np.stack([corner_vertex, corner_piece, turn.ravel() >= 1.0], 1)
    _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    vertex = corner_vertex[first]
    bones, weights = strongest(shell.weights[vertex])
    return Mesh(
        name=name,
        vertices=shell.vertices[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=np.stack([u, v], 1)[first],
        texture=texture,
        parts=PART_OF_BODY[bones[:, 0]],
        bones=bones,
        weights=weights,
        shininess=shininess,
        double_sided=True,
    )


def strongest(weights: Float[Array, "N 21"]) -> tuple[Int[Array, "N 4"], Float[Array, "N 4"]]:
    """The four bodies each vertex follows most, heaviest first, and their weights, summing to 1."""
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    kept = np.take_along_axis(weights, bones, 1)
    return bones.astype(np.int32), kept / kept.sum(1, keepdims=True)


def _unroll(
    piece: int, points: Float[Array, "N 3"], body: BareBody
) -> tuple[Float[Array, "N"], Float[Array, "N"]]:
    """Turns (0 to 1) around a piece's axis, from its hidden side, and metres along it."""
    if piece == TORSO:
        low, high = body.joints[INDEX["pelvis"]], body.joints[INDEX["neck"]]
        x = points[:, 0] - (low[0] + high[0]) / 2
        radius = np.hypot(x, points[:, 1])
        # Over the shoulders cloth runs inward rather than up: count both ways as length.
        slope = np.clip((points[:, 2] - (high[2] - 0.16)) / 0.10, 0, 1)
        turn = np.arctan2(points[:, 1], x) / (2 * np.pi) + 0.5
        return turn, points[:, 2] + slope * np.maximum(0, 0.2 - radius)
    a, b, c = (body.joints[INDEX[name]] for name in LIMBS[piece])
    first, second = unit(b - a), unit(c - b)
    length = np.linalg.norm(b - a)
    upper = np.minimum((points - a) @ first, length)
    lower = np.maximum((points - b) @ second, 0.0)
    out = points - (a + upper[:, None] * first + lower[:, None] * second)
    axis = unit(c - a)
    hidden = np.array([0, -np.sign(a[1]), -0.3]) if piece in (LEFT_ARM, RIGHT_ARM) else [-1, 0, 0]
    e1 = unit(-np.asarray(hidden) + (np.asarray(hidden) @ axis) * axis)
    turn = np.arctan2(out @ np.cross(axis, e1), out @ e1) / (2 * np.pi) + 0.5
    return turn, -(upper + lower)
