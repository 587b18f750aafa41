"""Joint visibility in each view, and the cause of occlusion, from the rendered surfaces.

A joint lies inside the body. It counts as visible when enough of the skin nearest to it is: points
spread over that skin move with the body and are compared with the surface drawn at their pixels.
Cloth may cover them; another limb, the rig or a prop may not.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.sequence import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.geometry import inverse, transform
from egocap_sim.core.bodies import BODIES, INDEX, LABEL_BODY, PARENT
from egocap_sim.core.part_labels import RIG, WEARER_FIRST, WEARER_LAST, wearer_part
from egocap_sim.human.body.person import Person
from egocap_sim.render.views import Views

SAMPLES = 16  # points of skin around each joint
PATCH = 160  # the skin vertices nearest to a joint from which they are chosen
CLOTH_M = 0.05  # how far cloth, hair or a helmet may stand off the skin along a ray
SHARE = 0.25  # of the samples must show; of a limb in full view, half face the camera


class JointVisibility:
    """Computes, frame by frame, which joints of one person each view of a rig sees."""

    def __init__(self, person: Person, rig: Rig) -> None:
        self._rig = rig
        chosen = np.array([skin_around(person, label) for label in LABELS])  # (18, S)
        self._body = person.body_owner[chosen].astype(int)
        self._offset = person.body_vertices[chosen] - person.joints[self._body]

    def __call__(
        self,
        views: Views,
        T_world_body: Float[Array, "21 4 4"],
        in_view: Bool[Array, "V 18"],
        only: Collection[int] | None = None,
    ) -> UInt8[Array, "V 18"]:
        """VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED or OCCLUDED (`data.sequence`) of joints and views.

        `in_view`: joints inside lens and image. The wearer's body, clothes and rig cause
        self-occlusion, everything else occlusion by others; the cause is what hides most samples.
        With `only`, the rows of other views are undefined.
        """
        skin_world = transform(T_world_body[self._body], self._offset[..., None, :])[..., 0, :]
        T_head_world = inverse(T_world_body[INDEX["head"]])
        result = np.full(in_view.shape, OUT_OF_VIEW, np.uint8)
        around, label = parts_around(), np.repeat(np.arange(len(LABELS)), SAMPLES)
        for v, mount in enumerate(self._rig.mounts):
            if only is not None and v not in only:
                continue
            skin = transform(inverse(mount.T_head_camera) @ T_head_world, skin_world.reshape(-1, 3))
            pixels, valid = mount.camera.project(skin)
            at = np.where(valid[:, None], pixels, -9.0)
            surface, part = views.surface_at(v, at, wanted=around[label])
            depth = np.linalg.norm(skin, axis=-1)
            shows = valid & (depth <= surface + CLOTH_M) & (around[label, part] | (part == 0))
            mine = (part >= WEARER_FIRST) & (part <= WEARER_LAST) | (part == RIG)
            seen = shows.reshape(-1, SAMPLES).mean(1) >= SHARE
            by_others = (~shows & valid & ~mine).reshape(-1, SAMPLES).sum(1)
            by_self = (~shows & valid & mine).reshape(-1, SAMPLES).sum(1)
            hidden = np.where(by_others > by_self, OCCLUDED, SELF_OCCLUDED)
            result[v] = np.where(in_view[v], np.where(seen, VISIBLE, hidden), OUT_OF_VIEW)
        return result


def patch_around(person: Person, label: str) -> Int[Array, "P"]:
    """The skin vertices nearest to a joint, of its body and the neighbours, nearest first."""
    body = INDEX[LABEL_BODY[label]]
    near = [INDEX[b] for b in _neighbours(LABEL_BODY[label])]
    at = person.joints[body] + person.landmarks[label]
    candidates = np.flatnonzero(np.isin(person.body_owner, near))
    vertices = person.body_vertices[candidates]
    return candidates[np.argsort(np.linalg.norm(vertices - at, axis=1), kind="stable")[:PATCH]]


def skin_around(person: Person, label: str) -> Int[Array, "S"]:
    """Skin vertices spread over the patch nearest to a joint, by farthest-point sampling."""
    patch = patch_around(person, label)
    points = person.body_vertices[patch]
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < SAMPLES:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return patch[chosen]


def _neighbours(body: str) -> set[str]:
    """A body, its parent and its children."""
    return {body, PARENT.get(body, body)} | {child for child, p in PARENT.items() if p == body}


@cache
def parts_around() -> Bool[Array, "18 256"]:
    """For every label, the parts that may lie over its skin: its neighbours, and theirs.

    Cloth is labelled by the body it follows most, so it carries labels one body farther along.
    """
    table = np.zeros((len(LABELS), 256), bool)
    for j, label in enumerate(LABELS):
        near = _neighbours(LABEL_BODY[label])
        for body in near.union(*(_neighbours(b) for b in near)):
            table[j, wearer_part(body)] = True
        table[j, RIG] = label == "head"  # a helmet sits on the skull as hair does
    return table


assert len(BODIES) == WEARER_LAST
