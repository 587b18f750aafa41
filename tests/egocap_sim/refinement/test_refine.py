"""Refinement by simulation: against mechanics that are known, and on tracks with faults."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from egocap.body.skeleton import DOF_INDEX, JOINTS, POINT_INDEX, points
from egocap.data.track import CONTACTS
from egocap.errors import InputError
from egocap.files import read_npz
from egocap.geometry import axis_angle, transform
from egocap.world.foot_points import HEEL_SHARE as TRACKED_HEEL
from egocap_sim.refinement.control import ControlConfig
from egocap_sim.refinement.humanoid import (
    HEEL_SHARE,
    HINGES,
    SITE_SUPPORT,
    SUPPORTS,
    build_humanoid,
)
from egocap_sim.refinement.reference import Reference
from egocap_sim.refinement.refine import Refinement, refine
from egocap_sim.refinement.report import save_forces, summary
from tests.egocap_sim.refinement.made_tracks import BODY, FPS, standing, track_of

MASS = 70.0
WEIGHT = MASS * 9.81


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def bow(frames=60):
    """Angles of two bows with the feet in place; the head goes down and forward."""
    bend = 0.3 * (1 - np.cos(np.linspace(0, 4 * np.pi, frames)))
    angles, heads = standing(frames)
    for side in ("left", "right"):
        angles[:, DOF_INDEX[f"{side}_hip_flexion"]] = bend
    heads[:, :3, :3] = axis_angle([0.0, 1.0, 0.0], bend)
    ankle = [POINT_INDEX[f"{side}_ankle"] for side in ("left", "right")]
    placed = transform(heads, points(BODY, angles)[:, ankle]).mean(1)
    heads[:, :3, 3] += [0.0, 0.0, 0.1] - placed
    return angles, heads


def vertical(found: Refinement, part=slice(None)):
    """Upward force of some supports in weights, a frame."""
    return found.support[:, part, 2].sum(1) / WEIGHT


def test_model_is_the_trackers_skeleton(rng):
    model = build_humanoid(BODY, MASS)
    data, angles = mujoco.MjData(model), rng.normal(0.0, 0.5, 37)
    data.qpos[7:] = angles[HINGES]
    mujoco.mj_kinematics(model, data)
    posed = points(BODY, angles)
    for i, joint in enumerate(JOINTS):
        np.testing.assert_allclose(data.body(joint.name).xpos, posed[i], atol=1e-12)
    assert model.body_subtreemass[1] == pytest.approx(MASS)
    for support, name in enumerate(SUPPORTS):
        sites = [data.site(str(i)).xpos for i in np.flatnonzero(np.isin(SITE_SUPPORT, support))]
        if not name.endswith("heel"):
            point = POINT_INDEX[name.replace("toe", "foot")]
            np.testing.assert_allclose(np.mean(sites, 0), posed[point], atol=1e-12)
    assert HEEL_SHARE == TRACKED_HEEL
    assert SUPPORTS[:4] == CONTACTS and len(SUPPORTS) == 10


def test_reference_velocities_and_accelerations_are_derivatives(rng):
    angles, heads = bow()
    heads[:, :3, :3] @= axis_angle([0.3, 0.2, 1.0], np.linspace(0, 1.5, len(heads)))
    motion = Reference.of(track_of(angles, heads), np.arange(len(angles)), 6.0)
    model, at, h = build_humanoid(BODY, MASS), np.array([0.71]), 1e-4
    before, after = motion.positions(np.concatenate([at - h, at + h]))
    difference = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, difference, 2 * h, before, after)
    np.testing.assert_allclose(motion.velocities(at)[0], difference, atol=1e-5)
    v = motion.velocities(np.concatenate([at - h, at + h]))
    np.testing.assert_allclose(motion.accelerations(at)[0], (v[1] - v[0]) / (2 * h), atol=1e-4)


def test_feet_bear_a_person_who_stands():
    found = refine(track_of(*standing()), MASS)
    assert found.refined.all() and found.moved.max() < 1e-3
    np.testing.assert_allclose(vertical(found), 1.0, atol=0.01)
    assert vertical(found, slice(4)).min() > 0.95
    assert np.abs(found.residual[:, :3]).max() < 0.01 * WEIGHT


def test_forces_are_those_of_newton():
    angles, heads = bow(90)
    found = refine(track_of(angles, heads), MASS)
    model = build_humanoid(BODY, MASS)
    data, centre = mujoco.MjData(model), np.empty((90, 3))
    followed = Reference.of(found.track, np.arange(90), 100.0)
    for t, pose in enumerate(followed.positions(found.track.times)):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centre[t] = data.subtree_com[1]
    acceleration = np.gradient(np.gradient(centre, 1 / FPS, axis=0), 1 / FPS, axis=0)
    needed = MASS * (acceleration + [0.0, 0.0, 9.81])
    given = found.support.sum(1) + found.residual[:, :3]
    np.testing.assert_allclose(given[5:-5] / WEIGHT, needed[5:-5] / WEIGHT, atol=0.03)
    assert summary(found)["residual"] < 0.02


def test_without_penalty_and_filter_the_motion_is_as_tracked():
    found = refine(track_of(*bow()), MASS, ControlConfig(residual=100.0, cutoff_hz=100.0))
    assert found.moved.max() < 1e-3
    np.testing.assert_allclose(found.residual, found.residual_before, atol=1e-3 * WEIGHT)


def test_flight_needs_no_support_and_hanging_is_kept():
    angles, heads = standing(60)
    t = np.arange(60) / FPS
    air = (t > 0.8) & (t < 1.2)
    heads[:, 2, 3] += np.where(air, 4.905 * (t - 0.8) * (1.2 - t), 0.0)
    jumped = refine(track_of(angles, heads, np.where(air[:, None], 0.0, np.ones(4))), MASS)
    assert jumped.refined.all()
    high = (t > 0.95) & (t < 1.05)
    assert np.linalg.norm(jumped.residual_before[high, :3], axis=1).max() < 0.15 * WEIGHT
    angles, heads = standing(60)
    heads[:, 0, 3] += 5.0 * t
    kept = refine(track_of(angles, heads, np.zeros((60, 4))), MASS)
    assert not kept.refined.any() and kept.moved.max() < 1e-9
    assert summary(kept)["refined"] == 0 and summary(kept)["moved_mm"] is None


def test_seat_bears_a_person_whose_feet_cannot():
    angles, heads = standing()
    for side in ("left", "right"):
        angles[:, DOF_INDEX[f"{side}_hip_flexion"]] = np.deg2rad(90)
        angles[:, DOF_INDEX[f"{side}_knee_flexion"]] = np.deg2rad(80)
    found = refine(track_of(angles, heads), MASS)
    assert vertical(found, slice(4, 6)).mean() > 0.5
    assert summary(found)["seat"] > 0.5


def test_noise_in_the_head_pose_is_not_followed(rng):
    angles, heads = standing(60)
    heads[:, :3, 3] += np.cumsum(rng.normal(0.0, 0.002, (60, 3)), axis=0)
    track = track_of(angles, heads)
    found = refine(track, MASS)
    jitter = [np.diff(t.T_world_head[:, :3, 3], 2, axis=0).std() for t in (track, found.track)]
    assert jitter[1] < 0.5 * jitter[0]
    changes = summary(found)
    assert changes["residual_95"] < changes["residual_before_95"] < 0.5
    assert changes["moved_mm"] < 10.0


def test_the_filter_takes_the_noise_and_leaves_the_motion(rng):
    t = np.arange(90) / FPS
    slow, noisy = standing(90), standing(90)
    slow[0][:, 20] = 0.5 * np.sin(2 * np.pi * t)
    noisy[0][:, 20] = slow[0][:, 20] + rng.normal(0.0, 0.01, 90)
    motion, same = (Reference.of(track_of(*m), np.arange(90), 6.0) for m in (noisy, slow))
    hinge = 7 + int(np.flatnonzero(HINGES == 20)[0])
    np.testing.assert_allclose(same.positions(t)[:, hinge], slow[0][:, 20], atol=0.003)
    error = motion.positions(t)[:, hinge] - slow[0][:, 20]
    assert error.std() < 0.008
    low_rate = replace(track_of(*slow), times=np.arange(90) / 10.0)  # below twice the cut-off
    unfiltered = Reference.of(low_rate, np.arange(90), 6.0).positions(low_rate.times)
    np.testing.assert_allclose(unfiltered[:, hinge], slow[0][:, 20], atol=1e-12)


def test_frames_without_a_head_pose_are_kept():
    track = track_of(*standing(60))
    known = np.ones(60, bool)
    known[25:35] = False
    counted = []
    found = refine(replace(track, in_world=known), MASS, on_frames=counted.append)
    np.testing.assert_array_equal(found.refined, known)
    assert sum(counted) == 2 * 60
    np.testing.assert_array_equal(found.track.angles[~known], track.angles[~known])
    assert not found.support[~known].any()


def test_heavier_people_press_harder():
    heavy, light = (refine(track_of(*standing(20)), mass) for mass in (100.0, 50.0))
    ratio = heavy.support[:, :, 2].sum(1) / light.support[:, :, 2].sum(1)
    np.testing.assert_allclose(ratio, 2.0, rtol=0.02)
    assert 60.0 < refine(track_of(*standing(20))).mass_kg < 80.0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"contacts": None}, "no contacts"),
        ({"offsets": None}, "no bones"),
        ({"in_world": np.arange(45) % 10 != 0}, "no stretch"),
    ],
)
def test_tracks_that_cannot_be_refined(change, text):
    with pytest.raises(InputError, match=text):
        refine(replace(track_of(*standing()), **change), MASS)
    with pytest.raises(InputError, match="mass of 5 kg"):
        refine(track_of(*standing()), 5.0)


def test_a_jump_between_frames_ends_a_stretch():
    angles, heads = standing(60)
    heads[30:, 0, 3] += 3.0
    found = refine(track_of(angles, heads), MASS)
    assert found.refined.all() and found.moved.max() < 0.01


def test_a_body_that_is_lost_ends_the_simulation(rng, monkeypatch):
    monkeypatch.setattr("egocap_sim.refinement.refine._LOST_M", 1e-5)
    angles, heads = standing(36)
    heads[:, :3, 3] += rng.normal(0.0, 0.01, (36, 3))
    with pytest.raises(InputError, match="cannot follow the track: lost at"):
        refine(track_of(angles, heads), MASS)


def test_forces_are_saved(tmp_path):
    found = refine(track_of(*standing(20)), MASS)
    save_forces(tmp_path / "forces.npz", found)
    saved = read_npz(tmp_path / "forces.npz")
    np.testing.assert_array_equal(saved["support"], found.support)
    assert tuple(saved["support_names"]) == SUPPORTS and saved["mass_kg"] == MASS
