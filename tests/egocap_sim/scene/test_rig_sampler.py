"""Sampled rigs: within their ranges, accepted everywhere, and what their lenses claim to be."""

import json
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egocap.cameras.rig_files import load_rig
from egocap_sim.render.fisheye import build_atlas
from egocap_sim.scene import rig_sampler
from egocap_sim.scene.config import RigTable
from egocap_sim.scene.rig_sampler import headgear_for, sample_rig
from egocap_sim.scene.rig_source import resolve_headgear, resolve_rig


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**63 - 1))
def test_every_seed_gives_a_rig_within_the_ranges(seed):
    rig = sample_rig(np.random.default_rng(seed))
    left, right = rig.T_head_camera
    slack = 5 * 0.003  # of the mounting error
    assert 0.06 - slack < np.linalg.norm(left[:3, 3] - right[:3, 3]) < 0.50 + slack
    for T, camera in zip(rig.T_head_camera, rig.cameras, strict=True):
        assert 0.02 - slack < T[0, 3] - rig_sampler.BROW_M < 0.30 + slack
        assert 140 <= np.degrees(2 * camera.max_angle) <= 220
        assert T[2, 2] < 0  # looks down, if obliquely
        rim = np.array([np.sin(camera.max_angle), 0.0, np.cos(camera.max_angle)])
        pixel, _ = camera.project(rim)
        reach = np.linalg.norm(pixel - camera.centre) / camera.width
        assert 0.43 < reach < 0.63
    assert rig.resized(320, 256).cameras[0].width == 320
    assert sample_rig(np.random.default_rng(seed)) == rig


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32))
def test_rays_and_pixels_undo_each_other(seed):
    rig = sample_rig(np.random.default_rng(seed))
    pixels = np.random.default_rng(1).uniform((0, 0), (1279, 1023), (200, 2))
    for camera in rig.cameras:
        rays, valid = camera.ray(pixels)
        again, seen = camera.project(rays[valid])
        assert seen.all() and valid.mean() > 0.5
        assert np.abs(again - pixels[valid]).max() < 1e-6


def test_all_models_come_and_rigs_survive_a_file(tmp_path):
    rigs = [sample_rig(np.random.default_rng(i)) for i in range(60)]
    models = Counter(rig.cameras[0].model for rig in rigs)
    assert set(models) == {"equidistant", "kannala_brandt", "ocam"} and min(models.values()) > 8
    for i, rig in enumerate(rigs[:6]):
        rig.to_json(tmp_path / f"{i}.json")
        assert load_rig(tmp_path / f"{i}.json") == rig
        json.dumps(rig.to_dict())


@pytest.mark.parametrize("seed", range(3))
def test_the_renderer_can_make_faces_for_it(seed):
    rig = sample_rig(np.random.default_rng(seed)).resized(160, 128)
    atlas = build_atlas(list(rig.cameras))
    assert all(inside.mean() > 0.5 for inside in atlas.inside)


def test_headgear_is_clear_of_the_cameras():
    worn = Counter()
    for i in range(200):
        rng = np.random.default_rng(i)
        rig = sample_rig(rng)
        gear = headgear_for(rig, rng)
        worn[gear] += 1
        forward = rig.T_head_camera[:, 0, 3].min() - rig_sampler.BROW_M
        assert gear == "none" or forward > 0.05
    assert set(worn) == {"none", "helmet", "headset"}


NADIR = np.array([0.1, 0.0, -1.5])  # about where the feet are, in the head frame


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**63 - 1))
def test_glasses_sit_before_the_face_and_see_the_feet(seed):
    rig = sample_rig(np.random.default_rng(seed), "glasses")
    places = rig.T_head_camera[:, :3, 3]
    assert rig.views == ("left", "right")
    assert 0.05 < places[0, 1] - places[1, 1] < 0.18
    assert (places[:, 0] > 0.105).all() and (places[:, 0] < 0.185).all()
    for T, camera in zip(rig.T_head_camera, rig.cameras, strict=True):
        assert 100 <= np.degrees(2 * camera.max_angle) <= 220
        ray = (NADIR - T[:3, 3]) @ T[:3, :3]
        assert np.arctan2(np.hypot(*ray[:2]), ray[2]) < camera.max_angle + np.radians(10)


@pytest.mark.parametrize("seed", range(12))
def test_headsets_have_two_cameras_to_the_sides(seed):
    rig = sample_rig(np.random.default_rng(seed), "headset")
    assert rig.views == ("front_left", "front_right", "side_left", "side_right")
    axes = rig.T_head_camera[:, :3, 2]
    assert axes[2, 1] > 0.15 and axes[3, 1] < -0.15 and (np.abs(axes[:2, 1]) < 0.5).all()
    assert (axes[:, 2] < 0).all()


def test_any_draws_every_family_at_every_roll_and_size():
    rigs = [sample_rig(np.random.default_rng(i), "any") for i in range(300)]
    assert set(Counter(len(rig.mounts) for rig in rigs)) == {1, 2, 4}
    assert {(r.cameras[0].width, r.cameras[0].height) for r in rigs} == set(rig_sampler.SIZES)
    up = [r.T_head_camera[0, :3, 1] for r in rigs]  # image down in the head frame
    assert min(d[2] for d in up) < -0.3 and max(d[2] for d in up) > 0.3  # some hang upside down


def test_a_family_decides_the_headgear_and_its_images_fit():
    for seed in range(40):
        table = RigTable(name="sampled", family="any", size=(420, 400))
        rig = resolve_rig(table, seed)
        gear = resolve_headgear(table, rig, seed)
        allowed = {1: {"helmet", "headset", "cap"}, 2: {"glasses"}, 4: {"headset"}}
        assert gear in allowed[len(rig.mounts)]
        assert all(c.width <= 420 and c.height <= 400 for c in rig.cameras)


def test_only_sampled_rigs_have_a_family():
    with pytest.raises(ValueError, match="sampled"):
        RigTable(name="egorig1", family="glasses")
