"""Housings and arms of the cameras: out of their own views, on the head, and labelled."""

from dataclasses import replace

import numpy as np
import pytest

from egocap.cameras.rig_files import load_rig
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.part_labels import RIG
from egocap_sim.core.resources import rig_file
from egocap_sim.human.clothing.camera_mounts import with_cameras
from egocap_sim.human.clothing.wardrobe import make_person

PERSON = make_person(3, headgear="helmet")


@pytest.mark.parametrize("gear", ["helmet", "headset", "cap", "glasses"])
@pytest.mark.parametrize("name", ["egorig1", "glasses", "headset4", "cap"])
def test_no_camera_sees_its_own_housing(name, gear):
    rig = load_rig(rig_file(name))
    rig = replace(rig, mounts=tuple(
        replace(m, camera=replace(m.camera, max_angle=np.radians(105))) for m in rig.mounts
    ))  # fmt: skip
    made = with_cameras(PERSON, rig, gear).actor.meshes[len(PERSON.actor.meshes) :]
    head = PERSON.joints[INDEX["head"]]
    for mount in rig.mounts:
        (housing,) = [m for m in made if m.name == f"camera {mount.name}"]
        assert (housing.parts == RIG).all() and (housing.bones[:, 0] == INDEX["head"]).all()
        T = mount.T_head_camera
        x, y, z = ((housing.vertices - head - T[:3, 3]) @ T[:3, :3]).T
        assert (np.arctan2(np.hypot(x, y), z) > mount.camera.max_angle).all()
        assert np.sqrt(x**2 + y**2 + z**2).max() < 0.08


def test_arms_join_housings_to_the_helmet():
    rig = load_rig(rig_file("egorig1"))
    arms = [m for m in with_cameras(PERSON, rig, "helmet").actor.meshes if m.name[:3] == "arm"]
    assert [m.name for m in arms] == ["arm left", "arm right"]
    for mesh, mount in zip(arms, rig.mounts, strict=True):
        points = mesh.vertices - PERSON.joints[INDEX["head"]]
        assert np.linalg.norm(points - mount.T_head_camera[:3, 3], axis=1).min() < 0.05
        assert points[:, 0].min() < 0.14


def test_a_rig_without_headgear_is_not_drawn():
    assert with_cameras(PERSON, load_rig(rig_file("egorig1")), None) is PERSON
