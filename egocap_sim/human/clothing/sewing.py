"""Sew cloth: its panels, the texture painted on them, and the drawn mesh."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap_sim.assets.mesh import Mesh
from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.numbering import distinct
from egocap_sim.human.body.skin import PART_OF_BODY
from egocap_sim.human.clothing.panels import GIRTH, lay_out, unroll
from egocap_sim.human.clothing.shell import Shell
from egocap_sim.human.clothing.tailoring import Cloth, paint


def sew(name: str, shell: Shell, body: BareBody, cloth: Cloth, shininess: float = 0.0) -> Mesh:
    """Make the mesh of a shell and paint its texture.

    Vertices are doubled where two pieces of cloth meet and at the hidden side of each.
    """
    corner_piece = np.repeat(shell.piece.take(shell.faces.T).max(0), 3)
    corner_vertex = shell.faces.ravel()
    turn, along = np.zeros(len(corner_vertex)), np.zeros(len(corner_vertex))
    spans = {}
    for piece in GIRTH:
        here = corner_piece == piece
        if here.any():
            turn[here], along[here] = unroll(piece, shell.vertices[corner_vertex[here]], body)
            spans[piece] = (float(along[here].max()) + 1e-4, float(along[here].min()) - 1e-4)
    turn = turn.reshape(-1, 3)
    turn = (turn + ((turn.max(1, keepdims=True) - turn) > 0.5)).ravel()  # across the seam
    key = (corner_vertex * len(GIRTH) + corner_piece) * 2 + (turn >= 1.0)
    first, index = distinct(key)
    vertex, piece_of = corner_vertex[first], corner_piece[first]
    turn, along = turn[first], along[first]
    panels = lay_out(spans)
    uv = np.zeros((len(vertex), 2))
    for piece, panel in panels.items():
        here = piece_of == piece
        uv[here] = panel.uv(turn[here], along[here])
    light = shell.light[vertex]
    samples = {p: (turn[piece_of == p], along[piece_of == p], light[piece_of == p]) for p in panels}
    bones, weights = strongest(shell.weights[vertex])
    return Mesh(
        name=name,
        vertices=shell.vertices[vertex],
        faces=index.reshape(-1, 3).astype(np.int32),
        uv=uv,
        texture=paint(panels, samples, cloth),
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
