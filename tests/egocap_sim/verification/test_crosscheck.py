"""The truth, found again in other ways; and untruths, found out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egocap.data.sequence import Sequence
from egocap.data.truth import SELF_OCCLUDED, VISIBLE
from egocap.errors import InputError
from egocap.geometry import GRAVITY, inverse, transform
from egocap_sim.motion.generators.registry import make_motion
from egocap_sim.motion.retarget.retarget import retarget
from egocap_sim.physics.simulation import simulate
from egocap_sim.record.recorder import generate
from egocap_sim.scene.config import Scene
from egocap_sim.verification.crosscheck import check_forces, check_pixels, check_rays
from egocap_sim.verification.integrity import verify


@pytest.fixture
def sequence(tiny_sequence: Path) -> Sequence:
    return Sequence(tiny_sequence)


def altered(sequence: Sequence, **arrays) -> Sequence:
    """The same sequence, whose truth says something else."""
    other = Sequence(sequence.folder)
    other.__dict__["truth"] = replace(sequence.truth, **arrays)
    return other


def test_visible_joints_have_their_body_and_depth_at_their_pixel(sequence):
    found = check_pixels(sequence)
    assert found.joints > 100 and found.measured > 0.9 * found.labelled
    assert found.labelled_share > 0.9 and found.depth_share > 0.95


def test_swapped_sides_and_wrong_distances_show_at_the_pixels(sequence):
    truth = sequence.truth
    swap = [0, 1, 6, 7, 8, 9, 2, 3, 4, 5, 14, 15, 16, 17, 10, 11, 12, 13]
    swapped = altered(sequence, joints_2d=truth.joints_2d[:, :, swap])
    assert check_pixels(swapped).labelled_share < 0.75
    nearer = altered(sequence, joints_camera=0.8 * truth.joints_camera)
    assert check_pixels(nearer).depth_share < 0.6


def test_rays_cast_in_mujoco_see_the_same_joints(sequence):
    found = check_rays(sequence, frames=2)
    assert found.joints > 40
    assert found.share > 0.95 and not found.disagreements
    assert f"{100 * found.share:.1f} % of {found.joints}" in found.text()


def test_rays_find_joints_recorded_as_hidden(sequence):
    seen = sequence.truth.visibility
    wrong = altered(sequence, visibility=np.where(seen == VISIBLE, SELF_OCCLUDED, seen))
    found = check_rays(wrong, frames=1)
    assert found.share < 0.5 and sum(found.disagreements.values()) > 5


def test_rays_need_pictures_of_one_instant(sequence, monkeypatch, tmp_path):
    text = (sequence.folder / "scene.toml").read_text() + '\n[sensor]\npreset = "webcam"\n'
    (tmp_path / "scene.toml").write_text(text)
    other = altered(sequence)
    other.folder = tmp_path
    with pytest.raises(InputError, match="images of one instant"):
        check_rays(other)


@pytest.fixture(scope="module")
def recorded(stand_in):
    """A motion of the stand-in as a sequence has it, without pictures."""

    def record(name: str, seconds: float, start_s: float = 0.0, **params):
        clip = make_motion(name, seconds + start_s + 1.0, np.random.default_rng(4), **params)
        t = simulate(stand_in, retarget(clip, stand_in), 30.0, round(30 * seconds) + 1, start_s)
        return t, stand_in.mass_kg * float(np.linalg.norm(GRAVITY))

    return record


def test_ground_carries_the_weight_standing(recorded):
    trajectory, weight = recorded("idle", 3.0, 1.0)
    total = trajectory.ground_force.sum(1)
    np.testing.assert_allclose(total[:, 2].mean(), weight, rtol=0.02)
    np.testing.assert_allclose(total[5:, 2], weight, rtol=0.10)  # once the soles have settled


def test_ground_carries_the_weight_over_the_cycles_of_a_walk(recorded):
    trajectory, weight = recorded("walk", 6.0, 2.0, stops=False)
    push = trajectory.ground_force.sum(1)[:, 2] + trajectory.root_wrench[:, 2]
    np.testing.assert_allclose(push.mean(), weight, rtol=0.03)
    np.testing.assert_allclose(trajectory.ground_force.sum(1)[:, 2].mean(), weight, rtol=0.12)
    assert push.std() > 0.03 * weight  # or it would not be a walk


def test_momentum_balances_and_a_false_force_shows(sequence, recorded, tmp_path):
    trajectory, weight = recorded("walk", 4.0, 2.0, stops=False)
    truth = sequence.truth
    long_motion = {
        "time": np.arange(len(trajectory.contact)) / 30,
        "T_world_body": trajectory.T_world_body,
        "ground_force": trajectory.ground_force,
        "root_wrench": trajectory.root_wrench,
    }
    (tmp_path / "person.json").write_text(f'{{"mass_kg": {weight / 9.81}}}')
    other = altered(sequence, **long_motion)
    other.folder = tmp_path
    found = check_forces(other)
    assert found is not None and abs(found.applied - found.required) < 0.03
    weak = altered(sequence, **long_motion | {"ground_force": 0.8 * trajectory.ground_force})
    weak.folder = tmp_path
    found = check_forces(weak)
    assert found is not None and abs(found.applied - found.required) > 0.10
    assert check_forces(altered(sequence, time=truth.time)) is None  # too short to tell


def test_other_people_are_in_the_truth_where_they_are_drawn(tiny_scene: Scene, tmp_path):
    scene = tiny_scene.model_dump() | {"name": "two", "frames": 2}
    scene["others"] = {"count": 1, "behaviours": ["gesture"], "farthest_m": 1.2}
    generate(Scene.model_validate(scene), tmp_path / "two")
    sequence = Sequence(tmp_path / "two")
    truth, others = sequence.truth, sequence.others
    assert others is not None
    assert others.joints_world.shape == (2, 1, 18, 3)
    assert others.joints_camera.shape == (2, len(sequence.manifest.views), 1, 18, 3)
    drawn = checked = 0
    for v, mount in enumerate(sequence.rig.mounts):
        T = truth.T_world_head @ mount.T_head_camera
        seen = transform(inverse(T)[:, None], others.joints_world.astype(float))
        np.testing.assert_allclose(seen, others.joints_camera[:, v], atol=1e-4)
        pixels, valid = mount.camera.project(others.joints_camera[0, v, 0].astype(float))
        mask = sequence.mask(0, mount.name)
        assert mask is not None
        column, row = np.rint(pixels[valid]).astype(int).T
        drawn, checked = drawn + (mask[row, column] == 200).sum(), checked + valid.sum()
    assert checked > 5 and drawn > 0.5 * checked  # the wearer hides some
    assert verify(tmp_path / "two").clean
