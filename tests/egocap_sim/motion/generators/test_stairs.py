"""A staircase is climbed on its treads: by the figure, and by a person under physics."""

import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.core.bodies import INDEX
from egocap_sim.core.ground_boxes import ground_height
from egocap_sim.human.body.soles import sole_points
from egocap_sim.motion.generators.registry import MOTIONS, make_motion, motion_parameters
from egocap_sim.motion.generators.stairs import StairsParams, fit_climber, stair_boxes
from egocap_sim.motion.kinematics import figure
from egocap_sim.motion.kinematics.limbs import bend_angle
from egocap_sim.motion.retarget.retarget import retarget
from egocap_sim.physics.simulation import simulate

PARAMS = StairsParams(treads=4.0)


@pytest.fixture(scope="module")
def clip():
    return make_motion("stairs", 16.0, np.random.default_rng(3), treads=4)


def test_the_soles_clear_the_treads_and_the_knees_bend_backwards(clip):
    for s in ("l_", "r_"):
        foot, toe = INDEX[s + "foot"], INDEX[s + "toe"]
        for body, corner in (
            (foot, figure.SOLE_HEEL), (foot, figure.SOLE_BALL), (toe, figure.SOLE_TIP)
        ):  # fmt: skip
            p = clip.positions[:, body] + clip.rotations[:, body] @ corner
            over = p[:, 2] - ground_height(stair_boxes(PARAMS), p[:, :2])
            assert over.min() > -0.002 and over.max() < 0.6
        knee = bend_angle(
            clip.rotations[:, INDEX[s + "thigh"]], clip.rotations[:, INDEX[s + "calf"]]
        )
        assert knee.min() > 0.05 and 1.0 < knee.max() < 2.2


def test_goes_up_to_the_landing_and_down_again(clip):
    z = clip.positions[:, 0, 2]
    top = stair_boxes(PARAMS)[-1].top
    assert z.max() - z[0] == pytest.approx(top, abs=0.03)
    assert z[-1] - z[0] == pytest.approx(0.0, abs=0.05)
    assert np.linalg.norm(np.diff(clip.positions, axis=0), axis=-1).max() * clip.fps < 4.0


def test_a_person_stands_on_the_treads_under_physics(clip, stand_in):
    reference = retarget(clip, stand_in, from_origin=False, grounded=False)
    reference = fit_climber(reference, stand_in, np.random.default_rng(3), PARAMS)
    t = simulate(stand_in, reference)
    assert t.stats.joint_error_cm < 1.0 and t.stats.planted_foot_speed_cm_s < 5.0
    assert t.stats.penetration_cm < 0.5 and t.stats.residual_wrench_bw < 0.3
    T = t.T_world_body
    lowest = sole_points(stand_in, T[..., :3, 3], T[..., :3, :3])[..., 2].min(-1)  # (T, 4)
    heights = lowest[t.contact]
    tops = np.array([0.0, *(box.top for box in reference.ground_boxes)])
    off = np.abs(heights[:, None] - tops)
    assert np.median(off.min(1)) < 0.01
    assert set(off.argmin(1)) == set(range(5))  # on every one of them, the floor too
    weight = stand_in.mass_kg * 9.81
    push = t.ground_force.sum(1)[:, 2].mean() / weight
    assert push == pytest.approx(1.0, abs=0.12)


def test_impossible_staircases_say_what_is_possible():
    with pytest.raises(InputError, match=r"rise is 0.5.*0.1 to 0.19"):
        motion_parameters("stairs", {"rise": 0.5})
    with pytest.raises(InputError, match="stairs"):
        make_motion("ladder", 2.0, np.random.default_rng(0))
    assert MOTIONS["stairs"].mounted is fit_climber
