"""What physics hands to rendering: where every body was, and how the ground pushed."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Bool, Float
from numpy import ndarray as Array


@dataclass(frozen=True)
class PhysicsStats:
    """Tracking error and contact quality of a simulated motion."""

    joint_error_cm: float  # mean over joints and frames, to the retargeted reference
    joint_error_p95_cm: float
    joint_error_max_cm: float
    planted_foot_speed_cm_s: float  # median horizontal speed of planted feet
    penetration_cm: float  # median depth of the lowest sole point below the floor, at least 0
    penetration_max_cm: float
    residual_wrench_bw: float  # median force of the root's residual wrench, in body weights
    ms_per_second: float  # processor time per simulated second
    raw_error_cm: float | None = None  # mean, to the motion file as recorded; None: no file
    raw_error_max_cm: float | None = None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A simulated motion sampled at the cameras' frame times.

    Body frames and their order: `core.bodies`. Feet: `FEET` for contacts, left and right for
    forces (world frame, newtons, on the person).
    """

    fps: float
    T_world_body: Float[Array, "T 21 4 4"]
    contact: Bool[Array, "T 4"]
    ground_force: Float[Array, "T 2 3"]
    root_wrench: Float[Array, "T 6"]  # residual force (N) and torque (N m) at the pelvis, world
    stats: PhysicsStats
