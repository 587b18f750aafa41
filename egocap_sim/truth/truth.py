"""Exact truth of a simulated motion: joints in every frame of reference, contacts and forces."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.labels import LABELS
from egocap.cameras.rig import Rig
from egocap.data.truth import OUT_OF_VIEW, VISIBLE, OthersTruth, Truth
from egocap.geometry import inverse, transform
from egocap_sim.core.bodies import INDEX, LABEL_BODY
from egocap_sim.core.trajectory import Trajectory
from egocap_sim.human.body.person import Person


def label_positions(
    person: Person, T_world_body: Float[Array, "T 21 4 4"]
) -> Float[Array, "T 18 3"]:
    """World positions of the 18 labels, metres."""
    bodies = [INDEX[LABEL_BODY[label]] for label in LABELS]
    offsets = np.stack([person.landmarks[label] for label in LABELS])
    return transform(T_world_body[:, bodies], offsets[:, None])[:, :, 0]


def truth_before_rendering(person: Person, trajectory: Trajectory, rig: Rig) -> Truth:
    """Derive the truth that needs no rendering.

    `visibility` holds only VISIBLE and OUT_OF_VIEW; rendering adds occlusion.
    """
    T_world_body = trajectory.T_world_body
    T_world_head = T_world_body[:, INDEX["head"]]
    joints_world = label_positions(person, T_world_body)
    joints_head = transform(inverse(T_world_head), joints_world)
    pixels, in_view = rig.project(joints_head)  # (V, T, J, 2), (V, T, J)
    in_view = np.moveaxis(in_view, 0, 1)
    joints_camera = np.stack(
        [transform(inverse(mount.T_head_camera), joints_head) for mount in rig.mounts], axis=1
    )
    return Truth(
        time=np.arange(len(T_world_body)) / trajectory.fps,
        T_world_head=T_world_head,
        joints_world=joints_world,
        joints_head=joints_head,
        joints_camera=joints_camera,
        joints_2d=np.moveaxis(pixels, 0, 1),
        in_view=in_view,
        visibility=np.where(in_view, VISIBLE, OUT_OF_VIEW).astype(np.uint8),
        T_world_body=T_world_body,
        contact=trajectory.contact,
        ground_force=trajectory.ground_force,
        root_wrench=trajectory.root_wrench,
    )


def others_truth(
    joints_world: Float[Array, "T O 18 3"], T_world_head: Float[Array, "T 4 4"], rig: Rig
) -> OthersTruth:
    """Other people's joints in the world and in the frames of the rig's cameras."""
    cameras = [
        transform(inverse(T_world_head @ mount.T_head_camera)[:, None], joints_world)
        for mount in rig.mounts
    ]
    return OthersTruth(joints_world.astype(np.float32), np.stack(cameras, 1).astype(np.float32))
