import os
import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from egocap.errors import InputError
from egocap_sim.core.bodies import BODIES, FEET, PARENTS
from egocap_sim.physics.model import FLOOR, MASS_SHARE, build_model, segment_masses


@pytest.fixture(scope="module")
def model(stand_in):
    return build_model(stand_in, 0.004)


def test_masses_sum_to_the_person(stand_in, model):
    assert segment_masses(stand_in).sum() == pytest.approx(stand_in.mass_kg)
    assert model.body_subtreemass[1] == pytest.approx(stand_in.mass_kg)


def test_mass_shares_are_those_of_a_whole_body():
    """De Leva's shares of limbs count twice; the cut-up ones still sum to a body."""
    paired = {"clavicle", "upperarm", "forearm", "hand", "thigh", "calf", "foot", "toe"}
    total = sum(share * (2 if name in paired else 1) for name, share in MASS_SHARE.items())
    assert total == pytest.approx(1.0, abs=0.005)
    leg = sum(MASS_SHARE[name] for name in ("thigh", "calf", "foot", "toe"))
    assert leg == pytest.approx(0.2037, abs=0.001)  # 14.47 + 4.57 + 1.33 % of the body


def test_bodies_are_ours_in_our_order(stand_in, model):
    assert tuple(model.body(i + 1).name for i in range(len(BODIES))) == BODIES
    np.testing.assert_array_equal(model.body_parentid[1:], np.array(PARENTS) + 1)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.xpos[1:], stand_in.joints, atol=1e-9)
    np.testing.assert_allclose(data.xmat[1:].reshape(-1, 3, 3), np.tile(np.eye(3), (21, 1, 1)))


def test_one_free_root_and_twenty_balls(model):
    assert list(model.jnt_type) == [mujoco.mjtJoint.mjJNT_FREE] + 20 * [mujoco.mjtJoint.mjJNT_BALL]
    assert (model.nq, model.nv) == (87, 66)


def test_only_feet_meet_the_floor(model):
    for i in range(model.ngeom):
        name = model.geom(i).name
        assert bool(model.geom_conaffinity[i]) == (name in FEET)
        assert bool(model.geom_contype[i]) == (name == FLOOR)


def test_left_and_right_weigh_the_same(model):
    for body in BODIES:
        if body.startswith("l_"):
            assert model.body(body).mass == model.body(body.replace("l_", "r_")).mass


@pytest.mark.parametrize("mass", [0.0, 1000.0, float("nan")])
def test_impossible_masses_are_refused(stand_in, mass):
    with pytest.raises(InputError, match="20 to 250"):
        build_model(replace(stand_in, mass_kg=mass), 0.004)


def test_broken_joints_are_refused(stand_in):
    with pytest.raises(InputError, match="not finite"):
        build_model(replace(stand_in, joints=np.full((21, 3), np.inf)), 0.004)


@pytest.mark.parametrize("renderer", ["egl", "osmesa", "glfw", "nonsense", ""])
def test_physics_needs_no_opengl_whatever_the_environment_asks_of_mujoco(renderer):
    code = (
        "import os, egocap_sim.physics.model as m; m.mujoco.mj_step; print(os.environ['MUJOCO_GL'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"MUJOCO_GL": renderer},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout.strip()) == (0, renderer), done.stderr


def test_physics_starts_no_search_for_a_library_of_windows():
    code = (
        "import os, sys, egocap_sim.physics.model as m\n"
        "assert 'glfw' not in sys.modules and 'MUJOCO_GL' not in os.environ\n"
    )
    unasked = {key: value for key, value in os.environ.items() if key != "MUJOCO_GL"}
    subprocess.run([sys.executable, "-c", code], env=unasked, check=True)
