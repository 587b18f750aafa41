"""Joint visibility in each view, and the cause of occlusion, from the rendered surfaces.

A joint lies inside the body. It counts as visible when enough of the skin nearest to it is visible:
points spread over that skin move with the body and are compared with the surface drawn at their
pixels. Cloth may cover them; another limb, the rig or a prop may not.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int, Integer, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.geometry import inverse, transform
from egocap_sim.core.bodies import BODIES, INDEX, LABEL_BODY, PARENT
from egocap_sim.core.part_labels import RIG, WEARER_FIRST, WEARER_LAST, wearer_part
from egocap_sim.human.body.person import Person
from egocap_sim.render.views import Views

SAMPLES = 16  # points of skin around each joint
PATCH = 160  # skin vertices nearest to a joint from which the points are chosen
CLOTH_M = 0.05  # largest distance of cloth, hair or a helmet from the skin, along a ray
SHARE = 0.25  # of the points must be visible; half of an unoccluded limb faces the camera


@dataclass(frozen=True, eq=False)
class SkinPoints:
    """Points of skin around each joint, fixed to the person's bodies."""

    body: Int[Array, "18 S"]
    offset: Float[Array, "18 S 3"]  # from the body's joint, metres

    @classmethod
    def around_joints(cls, person: Person, every: int | None = None) -> SkinPoints:
        """SAMPLES spread over the patch around each joint, or one in `every` of its vertices."""
        chosen = np.array([
            _spread_over_patch(person, label) if every is None else _patch(person, label)[::every]
            for label in LABELS
        ])  # fmt: skip
        body = person.body_owner[chosen].astype(int)
        return cls(body, person.body_vertices[chosen] - person.joints[body])

    def pose(self, T_world_body: Float[Array, "21 4 4"]) -> Float[Array, "18 S 3"]:
        """World positions, metres."""
        return transform(T_world_body[self.body], self.offset[..., None, :])[..., 0, :]


class JointVisibility:
    """Computes, frame by frame, which joints of one person each view of a rig sees."""

    def __init__(self, person: Person, rig: Rig) -> None:
        self._rig, self._points = rig, SkinPoints.around_joints(person)

    def __call__(
        self,
        views: Views,
        T_world_body: Float[Array, "21 4 4"],
        in_view: Bool[Array, "V 18"],
        only: Collection[int] | None = None,
    ) -> UInt8[Array, "V 18"]:
        """VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED or OCCLUDED (`data.sequence`) of joints and views.

        `in_view`: joints inside lens and image. With `only`, the rows of other views are undefined.
        """
        skin_world = self._points.pose(T_world_body)
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
            by_joint = (a.reshape(-1, SAMPLES) for a in (shows, valid, part))
            result[v] = np.where(in_view[v], classify(*by_joint)[0], OUT_OF_VIEW)
        return result


def classify(
    shows: Bool[Array, "J S"],
    valid: Bool[Array, "J S"],
    part: Integer[Array, "J S"],
) -> tuple[Int[Array, "J"], Float[Array, "J"]]:
    """VISIBLE, SELF_OCCLUDED or OCCLUDED of joints in view, and the visible share of their points.

    `valid`: points inside the lens; `part`: label of the first surface on the ray to each point.
    The wearer's body, clothes and rig cause self-occlusion, everything else occlusion by others;
    the cause is the one that hides more points.
    """
    share, hidden = shows.mean(-1), ~shows & valid
    mine = (part >= WEARER_FIRST) & (part <= WEARER_LAST) | (part == RIG)
    by_others = (hidden & ~mine).sum(-1) > (hidden & mine).sum(-1)
    cause = np.where(by_others, OCCLUDED, SELF_OCCLUDED)
    return np.where(share >= SHARE, VISIBLE, cause), share


def _patch(person: Person, label: str) -> Int[Array, "P"]:
    """The skin vertices nearest to a joint, of its body and the neighbours, nearest first."""
    body = INDEX[LABEL_BODY[label]]
    near = [INDEX[b] for b in _neighbours(LABEL_BODY[label])]
    at = person.joints[body] + person.landmarks[label]
    candidates = np.flatnonzero(np.isin(person.body_owner, near))
    vertices = person.body_vertices[candidates]
    return candidates[np.argsort(np.linalg.norm(vertices - at, axis=1), kind="stable")[:PATCH]]


def _spread_over_patch(person: Person, label: str) -> Int[Array, "S"]:
    """Vertices of a joint's patch by farthest-point sampling."""
    patch = _patch(person, label)
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
    """For every label, the parts that may cover its skin: its neighbours, and their neighbours.

    A vertex of cloth has the label of the body with the largest skinning weight. That may be one
    body farther from the joint.
    """
    table = np.zeros((len(LABELS), 256), bool)
    for j, label in enumerate(LABELS):
        near = _neighbours(LABEL_BODY[label])
        for body in near.union(*(_neighbours(b) for b in near)):
            table[j, wearer_part(body)] = True
        table[j, RIG] = label == "head"  # a helmet sits on the skull as hair does
    return table


assert len(BODIES) == WEARER_LAST
