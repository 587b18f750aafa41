"""Posed people: covered skin does not penetrate the cloth."""

import cv2
import numpy as np
import pytest

from egocap.cameras.rig_files import parse_rig
from egocap.geometry import axis_angle, rigid
from egocap_sim.assets.mesh import Actor
from egocap_sim.core.bodies import BODIES, INDEX, PARENTS
from egocap_sim.human.clothing.wardrobe import make_person

LEFT, FORWARD = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
POSES = {
    "stride": {"l_thigh": (LEFT, -0.55), "r_thigh": (LEFT, 0.5), "l_calf": (LEFT, 0.25),
               "r_calf": (LEFT, 0.6), "l_upperarm": (FORWARD, -0.6), "r_upperarm": (FORWARD, 0.6)},
    "arms up": {"l_upperarm": (FORWARD, 1.9), "r_upperarm": (FORWARD, -1.9)},
    "squat": {f"{s}_{b}": (LEFT, a) for s in "lr"
              for b, a in (("thigh", -1.8), ("calf", 2.0), ("foot", -0.3), ("upperarm", -1.0))},
    "sitting": {f"{s}_{b}": (LEFT, a) for s in "lr"
                for b, a in (("thigh", -1.5), ("calf", 1.5), ("forearm", -1.2))},
}  # fmt: skip
PEOPLE = [
    (1, {"top": "shirt", "bottom": "trousers"}),
    (2, {"top": "tshirt", "bottom": "shorts"}),
    (6, {"top": "dress"}),
]
EYES = [(1.9, 0.0, -0.5), (-1.9, 0.0, -0.5), (0.3, 1.9, -0.4), (0.5, 0.0, 0.35)]


def transforms(someone, turns):
    """World poses (21, 4, 4) of the bodies, each turned about its own joint."""
    world = np.zeros((21, 4, 4))
    for i, name in enumerate(BODIES):
        parent = PARENTS[i]
        offset = someone.joints[i] - (someone.joints[parent] if parent >= 0 else 0)
        local = rigid(axis_angle(*turns.get(name, (LEFT, 0.0))), offset)
        world[i] = (world[parent] if parent >= 0 else np.eye(4)) @ local
    return world


def rig():
    """Cameras around a person, which look at the waist."""
    cameras = []
    for i, eye in enumerate(EYES):
        x, y, z = np.array([0.0, 0.0, -0.65]) - eye
        cameras.append({
            "name": f"c{i}", "position": eye, "yaw": float(np.degrees(np.arctan2(y, x))),
            "pitch": float(np.degrees(np.arctan2(-z, np.hypot(x, y)))),
            "lens": {"model": "equidistant", "width": 400, "height": 400, "fov": 75.0},
        })  # fmt: skip
    return parse_rig({"name": "around", "cameras": cameras}, "test")


def painted(someone):
    """The person in flat colours: skin red, all else green."""
    flat = {True: (255, 0, 0), False: (0, 255, 0)}
    return Actor(someone.actor.name, tuple(
        type(m)(**{**vars(m), "texture": np.full((8, 8, 3), flat[m.name == "skin"], np.uint8),
                   "glows": True, "shininess": 0.0})
        for m in someone.actor.meshes
    ))  # fmt: skip


def islands(image):
    """Pixels of skin that cloth surrounds on all sides, and pixels of the person."""
    skin = (image[..., 0] > 128) & (image[..., 1] < 128) & (image[..., 2] < 64)
    cloth = (image[..., 1] > 128) & (image[..., 0] < 128) & (image[..., 2] < 64)
    _, labels = cv2.connectedComponents(skin.astype(np.uint8), connectivity=8)
    outside = cv2.dilate((~skin & ~cloth).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    open_ones = np.unique(labels[outside & skin])
    enclosed = skin & ~np.isin(labels, open_ones)
    return int(enclosed.sum()), int((skin | cloth).sum())


@pytest.mark.parametrize(("seed", "outfit"), PEOPLE)
def test_skin_stays_under_cloth(seed, outfit):
    pytest.importorskip("OpenGL")
    from egocap.errors import MachineError
    from egocap_sim.environment.places import make_place
    from egocap_sim.render.renderer import FisheyeRenderer

    wear = {"watch": "none", "gloves": "none", "glasses": "none", "hat": "none", "hair": "bald"}
    someone = make_person(seed, outfit=wear | outfit)
    place = make_place("room", np.random.default_rng(0), clear_radius=3.0)
    try:
        renderer = FisheyeRenderer(rig(), [painted(someone)], place)
    except MachineError as error:
        pytest.skip(str(error))
    with renderer:
        for pose, turns in POSES.items():
            world = transforms(someone, turns)
            skinning = world @ rigid(np.eye(3), -someone.joints)
            views = renderer.render(world[INDEX["head"]], {someone.actor.name: skinning})
            poking, person = np.sum([islands(image) for image in views.images], axis=0)
            assert person > 20_000
            assert poking < 0.002 * person, (pose, poking, person)
