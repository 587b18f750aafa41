"""People: deterministic, varied, covered by their clothes, valid when posed."""

import hashlib
import json
from functools import cache

import numpy as np
import pytest
from scipy.spatial import KDTree

from egocap.errors import InputError
from egocap.geometry import axis_angle, rigid
from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.core.part_labels import OTHER_PERSON, RIG
from egocap_sim.human.body.anny_model import anatomy
from egocap_sim.human.body.triangles import vertex_normals
from egocap_sim.human.clothing.accessories import ACCESSORIES
from egocap_sim.human.clothing.garments import BOTTOMS, TOPS, UNDER_DRESSES
from egocap_sim.human.clothing.hair import HAIRCUTS
from egocap_sim.human.clothing.shoes import SHOES
from egocap_sim.human.clothing.wardrobe import make_person

LEFT = np.array([0.0, 1.0, 0.0])
FORWARD = np.array([1.0, 0.0, 0.0])
POSES = {
    "squat": {b: (LEFT, a) for s in "lr" for b, a in
              ((f"{s}_thigh", -2.0), (f"{s}_calf", 2.1), (f"{s}_foot", -0.3))},
    "arms up": {"l_upperarm": (FORWARD, 2.2), "r_upperarm": (FORWARD, -2.2)},
    "arms down": {"l_upperarm": (FORWARD, -0.6), "r_upperarm": (FORWARD, 0.6),
                  "l_forearm": (LEFT, -1.5), "r_forearm": (LEFT, -1.5)},
}  # fmt: skip


@cache
def person(seed=3, **kwargs):
    return make_person(seed, **kwargs)


def digest(someone):
    total = hashlib.sha256()
    for m in someone.actor.meshes:
        for array in (m.vertices, m.faces, m.uv, m.texture, m.parts, m.bones, m.weights):
            total.update(np.ascontiguousarray(array).tobytes())
    total.update(someone.joints.tobytes() + json.dumps(someone.description).encode())
    return total.hexdigest()


def skinning(someone, turns):
    """Skinning transforms (21, 4, 4) of rotations (axis, angle) about the bodies' own joints."""
    world = np.zeros((21, 4, 4))
    for i, name in enumerate(BODIES):
        parent = PARENTS[i]
        offset = someone.joints[i] - (someone.joints[parent] if parent >= 0 else 0)
        axis, angle = turns.get(name, (LEFT, 0.0))
        local = rigid(axis_angle(axis, angle), offset)
        world[i] = (world[parent] if parent >= 0 else np.eye(4)) @ local
    return world @ rigid(np.eye(3), -someone.joints)


def posed(mesh, transforms):
    homogeneous = np.c_[mesh.vertices, np.ones(len(mesh.vertices))]
    return np.einsum("nk,nkij,nj->ni", mesh.weights, transforms[mesh.bones], homogeneous)[:, :3]


def test_same_seed_same_bytes_other_seed_another_person():
    assert digest(make_person(3)) == digest(person())
    assert len({digest(person(seed)) for seed in (3, 4, 5)}) == 3


@pytest.mark.parametrize("seed", range(8))
def test_sampled_people_are_plausible(seed):
    someone = person(seed)
    assert 1.50 <= someone.height_m <= 2.00
    assert 17.9 <= someone.mass_kg / someone.height_m**2 <= 35.1
    assert np.ptp(someone.body_vertices[:, 2]) == pytest.approx(someone.height_m, abs=1e-6)
    assert json.loads(json.dumps(someone.description)) == someone.description
    lowest = min(m.vertices[:, 2].min() for m in someone.actor.meshes)
    assert abs(lowest) < 0.01
    assert sum(len(m.faces) for m in someone.actor.meshes) <= 22_000


@pytest.mark.parametrize("seed", range(4))
def test_meshes_are_valid(seed):
    for mesh in person(seed).actor.meshes:
        n = len(mesh.vertices)
        assert np.isfinite(mesh.vertices).all()
        assert mesh.faces.min() >= 0
        assert mesh.faces.max() < n
        assert np.unique(mesh.faces).size == n, mesh.name  # nothing unused
        assert mesh.uv.shape == (n, 2)
        assert np.isfinite(mesh.uv).all()
        assert mesh.bones.shape == mesh.weights.shape == (n, 4)
        assert mesh.weights.sum(1) == pytest.approx(1)
        assert mesh.weights.min() >= 0
        assert mesh.bones.min() >= 0
        assert mesh.bones.max() < len(BODIES)
        assert (mesh.parts == 1 + mesh.bones[np.arange(n), mesh.weights.argmax(1)]).all()
        assert mesh.texture.dtype == np.uint8


@pytest.mark.parametrize("top", TOPS)
def test_tops_lie_outside_the_skin(top):
    check_outside(person(3, outfit=freeze(top=top)), "top")


@pytest.mark.parametrize("bottom", [name for name, cut in BOTTOMS.items() if cut])
def test_bottoms_lie_outside_the_skin(bottom):
    check_outside(person(3, outfit=freeze(bottom=bottom)), "bottom")


def check_outside(someone, name):
    """The vertices that seem to lie deepest, by the normal of the nearest skin, are outside."""
    mesh = next(m for m in someone.actor.meshes if m.name == name)
    skin, faces = someone.body_vertices, anatomy().faces
    _, near = KDTree(skin).query(mesh.vertices)
    normals = vertex_normals(skin, faces)[near]
    height = np.einsum("ij,ij->i", mesh.vertices - skin[near], normals)
    worst = mesh.vertices[np.argsort(height)[:30]]
    a, b, c = (skin[faces[:, i]] - worst[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    top = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    bottom = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    winding = np.arctan2(top, bottom).sum(1) / (2 * np.pi)  # 1 inside, 0 outside
    assert (winding < 0.5).all()


@pytest.mark.parametrize("shoes", SHOES)
@pytest.mark.parametrize("height", [1.45, 2.05])
def test_shoes_hold_the_foot_and_stand_on_the_floor(shoes, height):
    someone = person(4, height_m=height, outfit=freeze(shoes=shoes))
    mesh = next(m for m in someone.actor.meshes if m.name == "shoes")
    assert mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)
    feet = someone.body_vertices[someone.body_vertices[:, 2] < 0.03]
    for axis in (0, 1):
        assert mesh.vertices[:, axis].min() < feet[:, axis].min()
        assert mesh.vertices[:, axis].max() > feet[:, axis].max()
    sides = np.sign(mesh.vertices[:, 1])
    right = np.isin(mesh.bones[:, 0], [i for n, i in INDEX.items() if n.startswith("r_")])
    assert (sides[right] < 0).all()
    assert (sides[~right] > 0).all()


@pytest.mark.parametrize("pose", POSES)
def test_nothing_tears_when_posed(pose):
    someone = person(3, outfit=freeze(top="hoodie", bottom="wide_trousers"))
    transforms = skinning(someone, POSES[pose])
    for mesh in someone.actor.meshes:
        edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]]])
        length = np.linalg.norm(np.subtract(*mesh.vertices[edges.T]), axis=1)
        after = np.linalg.norm(np.subtract(*posed(mesh, transforms)[edges.T]), axis=1)
        assert (after - length).max() < 0.06, mesh.name


def test_part_labels_of_headgear_and_bystanders():
    helmet = person(3, headgear="helmet").actor.meshes[-1]
    assert helmet.name == "helmet"
    assert (helmet.parts == RIG).all()
    assert (helmet.bones[:, 0] == INDEX["head"]).all()
    assert helmet.vertices[:, 2].max() > person(3).body_vertices[:, 2].max()
    for mesh in person(3, headgear="headset", bystander=True).actor.meshes:
        assert (mesh.parts == OTHER_PERSON).all()


def test_given_values_are_used():
    someone = person(
        7,
        sex="female",
        height_m=1.62,
        age_years=60,
        skin_tone=0.8,
        phenotype=freeze(weight=0.7),
        outfit=freeze(top="shirt", top_fabric="stripes:white,navy", shoes="barefoot", hair="bob"),
    )
    said = someone.description
    assert someone.height_m == pytest.approx(1.62, abs=0.01)
    assert said["sex"] == "female"
    assert said["age_years"] == 60
    assert said["skin_tone"] == 0.8
    assert said["phenotype"]["weight"] == 0.7
    assert said["phenotype"]["gender"] >= 0.8
    assert said["outfit"]["top_fabric"]["colors"][:2] == ["white", "navy"]
    names = [m.name for m in someone.actor.meshes]
    assert {"skin", "top", "collar", "bottom", "hair", "locks"} <= set(names)
    assert "shoes" not in names
    assert len(set(names)) == len(names)


def test_socks_show_between_shoe_and_trousers():
    wear = {"bottom": "shorts", "shoes": "sneakers", "socks": "crew_socks", "sock_color": "white"}
    someone = person(3, outfit=freeze(**wear))
    socks = next(m for m in someone.actor.meshes if m.name == "socks")
    ankle = someone.joints[INDEX["l_foot"], 2]
    assert socks.vertices[:, 2].max() == pytest.approx(ankle + 0.16, abs=0.02)
    check_outside(someone, "socks")
    bare = person(3, outfit=freeze(**wear | {"socks": "no_socks"}))
    assert "socks" not in [m.name for m in bare.actor.meshes]


@pytest.mark.parametrize("top", ["dress", "summer_dress"])
def test_dresses_replace_trousers(top):
    for seed in (3, 4):
        someone = person(seed, outfit=freeze(top=top))
        assert someone.description["outfit"]["bottom"] in UNDER_DRESSES
        skirt = next(m for m in someone.actor.meshes if m.name == "skirt")
        knee = someone.joints[INDEX["l_calf"], 2]
        assert abs(skirt.vertices[:, 2].min() - knee) < 0.15
    trousers = person(3, outfit=freeze(bottom="trousers"))
    assert "skirt" not in [m.name for m in trousers.actor.meshes]


@pytest.mark.parametrize(
    ("kind", "name", "body"),
    [(k, n, {"watch": "l_forearm", "gloves": "l_hand"}.get(k, "head"))
     for k, fits in ACCESSORIES.items() for n in fits],
)  # fmt: skip
def test_accessories_sit_where_they_are_worn(kind, name, body):
    without = dict.fromkeys(ACCESSORIES, "none")
    bare = [m.name for m in person(3, outfit=freeze(without)).actor.meshes]
    someone = person(3, outfit=freeze(without | {kind: name}))
    (worn,) = (m for m in someone.actor.meshes if m.name not in bare)
    assert INDEX[body] in worn.bones[:, 0]
    away, _ = KDTree(someone.body_vertices).query(worn.vertices)
    assert np.median(away) < 0.05
    assert len(worn.faces) < 3_500


def test_every_haircut_can_be_worn():
    for hair in HAIRCUTS:
        names = [m.name for m in person(5, outfit=freeze(hair=hair)).actor.meshes]
        assert ("hair" in names) == (hair != "bald")


@pytest.mark.parametrize(
    ("wish", "valid"),
    [
        ({"height_m": 5.0}, "1.4 to 2.1"),
        ({"height_m": float("nan")}, "1.4 to 2.1"),
        ({"age_years": 7}, "18 to 90"),
        ({"sex": "other"}, "female, male"),
        ({"skin_tone": 2}, "0 to 1"),
        ({"headgear": "crown"}, "helmet, headset"),
        ({"phenotype": {"charm": 1}}, "weight"),
        ({"phenotype": {"weight": 3}}, "0 to 1"),
        ({"phenotype": {"weight": "much"}}, "0 to 1"),
        ({"height_m": "tall"}, "1.4 to 2.1"),
        ({"outfit": {"top": "toga"}}, "hoodie"),
        ({"outfit": {"scarf": "toga"}}, "top_fabric"),
        ({"outfit": {"top_fabric": "stripes:white,navy,red,blue"}}, "1 to 3"),
        ({"outfit": {"top_fabric": "stripes:chartreuse"}}, "navy"),
        ({"outfit": {"shoes": "skis"}}, "barefoot"),
        ({"outfit": {"hat": "crown"}}, "sun_hat"),
        ({"outfit": {"hat": "cap"}, "headgear": "helmet"}, "none"),
        ({"outfit": {"hat": "beanie"}, "headgear": "cap"}, "hat 'cap', or headgear 'none'"),
        ({"outfit": {"top": "tshirt", "bottom": "none"}}, "dress"),
        ({"outfit": {"top": "dress", "bottom": "shorts"}}, "leggings"),
        ({"seed": -1}, "from 0"),
        ({"seed": "x"}, "from 0"),
    ],
)
def test_invalid_values_raise_with_the_valid_ones(wish, valid):
    with pytest.raises(InputError, match=valid):
        make_person(**({"seed": 3} | wish))


class freeze(dict):
    """Keyword arguments that can be the key of a cache."""

    def __hash__(self):
        return hash(tuple(sorted(self.items())))
