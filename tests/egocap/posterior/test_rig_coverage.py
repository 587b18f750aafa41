"""Coverage of rigs: what no camera looks at is not seen, and bounded by the prior alone."""

import numpy as np
import pytest

from egocap.body.labels import LABEL_INDEX, other_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import parse_rig
from egocap.posterior.information import joint_covariance, prior_information, rms_mm
from egocap.posterior.rig_coverage import everyday_poses, rig_coverage

PERSON = Proportions.from_lengths(1.75)


@pytest.fixture(scope="module")
def poses():
    return everyday_poses(30, np.random.default_rng(0))


def stereo(pitch=90.0):
    lens = {"model": "equidistant", "width": 640, "height": 512, "fov": 180.0}
    stereo = {"baseline": 0.35, "forward": 0.37, "up": 0.14, "pitch": pitch}
    return parse_rig({"name": "r", "lens": lens, "stereo": stereo}, "r")


def test_poses_are_within_the_limits(poses):
    assert (poses >= LIMITS[:, 0]).all() and (poses <= LIMITS[:, 1]).all()
    assert poses.std(0).min() > 0.01


def test_a_rig_that_looks_up_leaves_the_prior(poses):
    up = rig_coverage(stereo(-90.0), PERSON, poses)
    assert up.any_view.max() == 0.0
    blind = np.linalg.inv(prior_information(poses))
    bound = rms_mm(joint_covariance(poses, PERSON, blind))
    np.testing.assert_allclose(up.bound_mm, np.sqrt((bound**2).mean(0)))
    down = rig_coverage(stereo(), PERSON, poses)
    assert down.any_view[LABEL_INDEX["neck"]] == 1.0
    assert (down.bound_mm <= up.bound_mm + 1e-6).all()
    assert down.summary["bound_mm"] < 0.7 * up.summary["bound_mm"]


def test_fewer_views_see_less_and_bound_less(poses):
    rig = stereo()
    alone = Rig("one", rig.mounts[:1])
    both, one = rig_coverage(rig, PERSON, poses), rig_coverage(alone, PERSON, poses)
    assert (one.any_view <= both.any_view).all() and (one.any_view >= both.all_views).all()
    assert (one.bound_mm >= both.bound_mm - 1e-6).all()


def test_a_symmetric_rig_sees_both_sides_alike(poses):
    found = rig_coverage(stereo(), PERSON, poses)
    for name, j in LABEL_INDEX.items():
        other = LABEL_INDEX[other_side(name)]
        assert found.any_view[j] == found.any_view[other]
        assert found.bound_mm[j] == pytest.approx(found.bound_mm[other])
