"""Arms that are found by their colour where the pose has them elsewhere."""

import numpy as np
import pytest

from egocap.appearance.arm_search import GATE, ArmSearch
from egocap.body.gaussians import RADIUS_SIGMAS
from egocap.body.labels import LABEL_INDEX
from egocap.body.skeleton import DOF_INDEX, DOFS, forward
from egocap.image_model.body_kernel import gaussian_centres
from egocap.image_model.image_rays import ray_colours
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import Background, learn_palette
from tests.egocap.image_model.test_palette import BODY, GREY, PERSON, POSE, RAYS, RIG, picture

RIGHT = 1
WRIST = LABEL_INDEX["right_wrist"]
SEARCH = ArmSearch(RIG, RAYS, BODY, RIGHT)


def raised(degrees):
    pose = POSE.copy()
    pose[DOF_INDEX["right_shoulder_raise"]] += np.deg2rad(degrees)
    return pose


@pytest.fixture(scope="module")
def unlike():
    """Dissimilarities in a picture of the pose, by the palette and the background of it."""
    images, background = picture(GREY), Background()
    bins = background.bins.of(ray_colours(RAYS, images))
    background.update(bins, ImageModel(BODY, RAYS).visibility(POSE).sum(1))
    table = background.compare(learn_palette(BODY, RAYS, [(images, POSE)]), bins)
    return np.ascontiguousarray(table.unlike[:, table.bins])


def test_angles_and_joints_are_those_of_one_arm():
    names = [DOFS[i] for i in np.flatnonzero(SEARCH.angles)]
    assert len(names) == 8 and all(name.startswith("right_") for name in names)
    assert SEARCH.joints.sum() == 3


def test_a_lost_arm_is_found_and_one_in_place_stays(unlike):
    assert SEARCH.propose(POSE, unlike) is None
    lost = raised(70.0)
    found = SEARCH.propose(lost, unlike)
    assert found is not None
    true, before, after = (forward(PERSON, p)[WRIST] for p in (POSE, lost, found))
    assert np.linalg.norm(after - true) < 0.4 * np.linalg.norm(before - true)
    assert np.array_equal(found[~SEARCH.angles], lost[~SEARCH.angles])


def test_costs_are_those_of_drawn_spheres(unlike):
    """Against every ray and sphere, one after the other."""
    poses = np.stack([POSE, raised(30.0)])
    arm, radius = SEARCH._arm, RADIUS_SIGMAS * BODY.sigma
    origins = RAYS.origins[RAYS.view]
    for pose, cost in zip(poses, SEARCH._costs(poses, unlike), strict=True):
        to = gaussian_centres(pose[None], BODY)[0][None] - origins[:, None]
        middle = np.einsum("pgi,pi->pg", to, RAYS.direction)
        inside = radius**2 - (to**2).sum(-1) + middle**2
        hit = (inside >= 0.0) & (middle > 0.0)
        depth = np.where(hit, middle - np.sqrt(np.maximum(inside, 0.0)), np.inf)
        which = depth.argmin(1)
        alone = depth.copy()
        alone[:, arm] = np.inf
        rays = np.arange(len(RAYS))
        behind = np.where(np.isfinite(alone.min(1)), unlike[alone.argmin(1), rays], 0.0)
        changed = np.isfinite(depth.min(1)) & np.isin(which, arm)
        expected = (unlike[which, rays] - behind)[changed].sum()
        assert changed.sum() > 10
        assert cost == pytest.approx(expected, abs=0.1 * GATE)
