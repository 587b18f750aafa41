"""Posed Gaussians: torch and compiled form against the skeleton and against each other."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import LIMITS, SPREAD, points
from egocap.image_model import body_kernel
from egocap.image_model.torch_visibility import joint_frames, pose_gaussians

BODY = GaussianBody.from_proportions(Proportions.from_lengths(1.75))
POSES = np.clip(SPREAD * np.random.default_rng(0).normal(size=(5, 37)), LIMITS[:, 0], LIMITS[:, 1])


def compiled(body, angles):
    origins, axes, centres = np.empty((17, 3)), np.empty((37, 3)), np.empty((len(body.parts), 3))
    chain = body_kernel.make_chain(body)
    body_kernel.pose(chain, angles, origins, axes, centres)
    return chain, origins, axes, centres


def test_frames_sit_on_the_skeletons_joints():
    _, origins = joint_frames(BODY, torch.tensor(POSES))
    np.testing.assert_allclose(origins[:, 1:], points(BODY.proportions, POSES)[:, :17], atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_a_gaussian_at_a_bones_end_follows_the_next_joint(pose):
    """An outside oracle of the rotations: the skeleton's own children."""
    from egocap.body.skeleton import JOINTS, POINT_PARENTS

    for child in (4, 5, 6, 13, 14, 15):
        joint = np.full(91, POINT_PARENTS[child])
        offset = np.tile(BODY.proportions.offsets[child], (91, 1))
        moved = pose_gaussians(replace(BODY, joint=joint, offset=offset), torch.tensor(pose))
        expected = points(BODY.proportions, pose)[child]
        np.testing.assert_allclose(moved[0], expected, atol=1e-12, err_msg=JOINTS[child].name)


@pytest.mark.parametrize("pose", POSES)
def test_compiled_form_is_the_same(pose):
    _, origins, _, centres = compiled(BODY, pose)
    np.testing.assert_allclose(centres, pose_gaussians(BODY, torch.tensor(pose)), atol=1e-12)
    np.testing.assert_allclose(origins, joint_frames(BODY, torch.tensor(pose))[1][1:], atol=1e-12)


def test_forces_become_the_gradient_that_autograd_finds():
    rng = np.random.default_rng(3)
    force = rng.normal(size=(91, 3))
    angles = torch.tensor(POSES[0], requires_grad=True)
    work = (pose_gaussians(BODY, angles) * torch.tensor(force)).sum()
    (expected,) = torch.autograd.grad(work, angles)
    chain, origins, axes, centres = compiled(BODY, POSES[0])
    wrench, loaded = np.zeros((17, 6)), np.zeros(17, bool)
    for q in np.flatnonzero(chain.carrier >= 0):
        body_kernel.add_force(wrench, chain.carrier[q], centres[q], force[q])
        loaded[chain.carrier[q]] = True
    row, which = np.zeros(37), np.zeros(37, int)
    count = body_kernel.angle_derivatives(chain, origins, axes, wrench, loaded, row, which)
    gradient = np.zeros(37)
    gradient[which[:count]] = row[:count]
    np.testing.assert_allclose(gradient, expected, atol=1e-10)
    assert not wrench.any() and not loaded.any()
