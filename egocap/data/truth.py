"""Truth of a simulated sequence, for evaluations: of the wearer, the sensor and other people.

Footage has none. A tracker or a detector is given none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8
from numpy import ndarray as Array

from egocap.data.arrays import FrameArrays

BLACK = -1  # `SensorTruth.source` of a dropped frame that is recorded black
VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED, OCCLUDED = range(4)
"""Values of `Truth.visibility`; out of view: of the image or lens; OCCLUDED: by other things."""


@dataclass(frozen=True, eq=False)
class Truth(FrameArrays):
    """Exact state of the simulated person at every frame. Axis J follows `labels.LABELS`."""

    time: Float[Array, "T"]
    T_world_head: Float[Array, "T 4 4"]
    joints_world: Float[Array, "T 18 3"]
    joints_head: Float[Array, "T 18 3"]
    joints_camera: Float[Array, "T V 18 3"]
    joints_2d: Float[Array, "T V 18 2"]  # pixels; meaningful where `in_view`
    in_view: Bool[Array, "T V 18"]  # inside the lens's field of view and the image
    visibility: UInt8[Array, "T V 18"]  # VISIBLE, OUT_OF_VIEW, SELF_OCCLUDED, OCCLUDED
    T_world_body: Float[Array, "T 21 4 4"]  # `egocap_sim.core.bodies.BODIES`
    contact: Bool[Array, "T 4"]  # left foot, left toe, right foot, right toe on the ground
    ground_force: Float[Array, "T 2 3"]  # left, right; newtons, world, on the person
    root_wrench: Float[Array, "T 6"]  # residual force (N) and torque (N m) at the pelvis

    @property
    def propped(self) -> Bool[Array, "T"]:
        """Whether no foot touches, yet the wearer does not fall: contacts are not known.

        The residual force carries half the weight or more, as on the rungs of a recorded ladder
        that the simulated world does not have.
        """
        residual = self.root_wrench[:, 2]
        weight = (self.ground_force.sum(1)[:, 2] + residual).mean()  # over time, they are equal
        return ~self.contact.any(1) & (residual > 0.5 * weight)


@dataclass(frozen=True, eq=False)
class SensorTruth(FrameArrays):
    """Sensor effects on every frame; absent for an ideal sensor.

    `Truth` holds joints_camera, joints_2d, in_view and visibility at the instant at which the view
    exposed each joint, everything else at the frame's time. The truth of a dropped frame is that of
    the lost image.
    """

    time: Float[Array, "T V"]  # s, middle of the exposure of the view's middle row
    joint_time: Float[Array, "T V 18"]  # s, middle of the exposure of the joint's row
    exposure_ev: Float[
        Array, "T V"
    ]  # exposure relative to the rendered image, stops; includes flicker
    source: Int64[Array, "T V"]  # index of the frame whose image is recorded; BLACK: none
    subframes: Int64[Array, "T"]  # number of subframes averaged per image

    @property
    def dropped(self) -> Bool[Array, "T V"]:
        """Whether a frame was dropped and another image is recorded for it."""
        return self.source != np.arange(len(self.source))[:, None]


@dataclass(frozen=True, eq=False)
class OthersTruth(FrameArrays):
    """Joints of other people at every frame's time; axis O follows `[others]`, float32.

    Absent in sequences without other people.
    """

    joints_world: Float[Array, "T O 18 3"]
    joints_camera: Float[Array, "T V O 18 3"]
