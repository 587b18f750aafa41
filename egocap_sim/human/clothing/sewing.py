"""From cloth to a mesh: panels, the texture painted on them, and texture coordinates."""

from __future__ import annotations

import numpy as np

from egocap_sim.assets.mesh import Mesh
from egocap_sim.human.body.anny_model import BareBody
from egocap_sim.human.body.skinning import skinned_mesh
from egocap_sim.human.body.triangles import distinct
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
    vertex, pieces, turn, along = (a[first] for a in (corner_vertex, corner_piece, turn, along))
    panels, light = lay_out(spans), shell.light[vertex]
    uv, samples = np.zeros((len(vertex), 2)), {}
    for piece, panel in panels.items():
        here = pieces == piece
        uv[here] = panel.uv(turn[here], along[here])
        samples[piece] = turn[here], along[here], light[here]
    return skinned_mesh(
        name, shell.vertices[vertex], index.reshape(-1, 3), uv, paint(panels, samples, cloth),
        shell.weights[vertex], shininess,
    )  # fmt: skip
