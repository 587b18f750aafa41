"""Where a posed body's Gaussians are: torch, batched, differentiable by the joint angles.

The readable form; `egocap.image_model.image_kernel` has the compiled one.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from egocap.body.gaussians import GaussianBody
from egocap.body.skeleton import AXES, DOF_JOINT, JOINTS, POINT_PARENTS


def pose_gaussians(
    body: GaussianBody, angles: Float[Tensor, "*batch 37"]
) -> Float[Tensor, "*batch G 3"]:
    """Centres of the Gaussians in the head frame, metres.

    Source: product of exponentials, Murray, Li & Sastry 1994, ch. 3.
    """
    rotations, origins = joint_frames(body, angles)
    carrier = torch.as_tensor(body.joint + 1, device=angles.device)  # 0 is the skull
    offset = angles.new_tensor(body.offset)
    turned = (rotations[..., carrier, :, :] @ offset[..., None])[..., 0]
    return origins[..., carrier, :] + turned


def joint_frames(
    body: GaussianBody, angles: Float[Tensor, "*batch 37"]
) -> tuple[Float[Tensor, "*batch 18 3 3"], Float[Tensor, "*batch 18 3"]]:
    """Rotation and origin of the skull and of the 17 joints' frames in the head frame."""
    batch = angles.shape[:-1]
    eye = torch.eye(3, dtype=angles.dtype, device=angles.device).expand(*batch, 3, 3)
    rotations, origins = [eye], [angles.new_zeros(*batch, 3)]
    turns = _exponentials(angles)
    offsets = angles.new_tensor(body.proportions.offsets)
    for i in range(len(JOINTS)):
        parent = POINT_PARENTS[i] + 1
        R = rotations[parent]
        origins.append(origins[parent] + R @ offsets[i])
        for d in (d for d, joint in enumerate(DOF_JOINT) if joint == i):
            R = R @ turns[..., d, :, :]
        rotations.append(R)
    return torch.stack(rotations, -3), torch.stack(origins, -2)


def _exponentials(angles: Float[Tensor, "*batch 37"]) -> Float[Tensor, "*batch 37 3 3"]:
    """Rodrigues' rotation of every degree of freedom about its rest axis."""
    x, y, z = angles.new_tensor(AXES).unbind(-1)
    o = torch.zeros_like(x)
    K = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).reshape(-1, 3, 3)
    sin, cos = angles.sin()[..., None, None], angles.cos()[..., None, None]
    return torch.eye(3, dtype=K.dtype, device=K.device) + sin * K + (1.0 - cos) * (K @ K)
