"""The log posterior of one frame's pose: prior, limits, and detections in every view.

    log p(theta | detections) = log N(angles; posture) - w sum(beyond limits)^2
        - 1/2 |scales / sd|^2 - 1/2 |rig errors / sd|^2
        + 1/T sum log t_nu(whitened pixel residual)       + a constant

The posture Gaussian is the tracker's, at full weight: a density from which poses can be drawn
(`synthetic_pose`), so that calibration can be tested. Limits are walls of finite stiffness, because
people's ranges differ by degrees: smooth, proper, and without a reparametrisation that would
distort the density near them. Student-t errors have the stated standard deviations. Whether a joint
is detected carries no information.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.body.labels import without_side
from egocap.body.proportions import Proportions
from egocap.body.skeleton import (
    DOF_COUNT,
    DOFS,
    LABEL_POINTS,
    LIMITS,
    POINTS,
    forward,
)
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.pose.config import TrackerConfig
from egocap.pose.kernel import make_model
from egocap.pose.pose_prior import load_posture
from egocap.posterior import curvature, hamiltonian, kernel
from egocap.posterior.config import PosteriorConfig
from egocap.posterior.measurement import Measurement, measure

SCALES: dict[str, tuple[str, ...]] = {
    "trunk": ("neck", "upper_spine", "lower_spine"),
    "shoulders": ("clavicle", "shoulder"),
    "upper_arms": ("elbow",),
    "forearms": ("wrist",),
    "hands": ("hand",),
    "hips": ("hip",),
    "thighs": ("knee",),
    "shanks": ("ankle",),
    "feet": ("foot",),
}
"""Bones with one common scale, by the point at their far end, left and right alike."""

RIG_ERRORS = ("turn_x", "turn_y", "turn_z", "shift_x", "shift_y", "shift_z")
"""Of one camera, in its own axes: the point's coordinates are turned, then shifted."""

UNSCALED = -1

LogLikelihood = Callable[[Float[Array, "W 37"]], Float[Array, "W"]]
"""Log likelihood of angles [rad], up to a constant."""


class LogPosterior:
    """The density of one frame. Parameters N: 37 angles [rad], then scales, then rig errors."""

    def __init__(
        self,
        measurement: Measurement,
        rig: Rig,
        proportions: Proportions,
        config: PosteriorConfig = PosteriorConfig(),  # noqa: B008 (frozen)
        extra: LogLikelihood | None = None,
    ) -> None:
        self.measurement, self.rig, self.proportions = measurement, rig, proportions
        self.config, self.extra = config, extra
        self.names = parameter_names(config, rig.views)
        self.body = make_body(proportions)
        self.prior = make_prior(config, len(rig.mounts))
        self.optics = make_optics(rig, config)
        self.data = kernel.Data(
            measurement.pixels, measurement.whiten, measurement.weights / config.temperature,
            float(config.degrees),
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def __call__(self, thetas: Float[Array, "W N"]) -> Float[Array, "W"]:
        """Log posterior of many parameter vectors, up to a constant."""
        thetas = np.ascontiguousarray(thetas, float)
        out = np.empty(len(thetas))
        kernel.log_probs(self.body, self.prior, self.optics, self.data, thetas, out)
        if self.extra is not None:
            out += self.extra(thetas[:, :DOF_COUNT])
        return out

    def derivatives(
        self, theta: Float[Array, "N"], expected: bool = False
    ) -> tuple[float, Float[Array, "N"], Float[Array, "N N"]]:
        """Log posterior without `extra`, its gradient, and minus its Gauss-Newton Hessian.

        With `expected`, Student-t errors count in the Hessian by their mean information at most.
        """
        g, H = np.empty(self.size), np.empty((self.size, self.size))
        value = curvature.derivatives(
            self.body, self.prior, self.optics, self.data, np.asarray(theta, float), expected,
            H, g,
        )  # fmt: skip
        return float(value), g, H

    def gradients(self, thetas: Float[Array, "W N"]) -> Float[Array, "W N"]:
        """Gradients of the log posterior without `extra`."""
        thetas = np.ascontiguousarray(thetas, float)
        out = np.empty(thetas.shape)
        hamiltonian.gradients(self.body, self.prior, self.optics, self.data, thetas, out)
        return out

    def leapfrog(
        self, roots: Float[Array, "K N N"], which: Int[Array, "W"], sizes: Float[Array, "W"],
        steps: Int[Array, "W"], thetas: Float[Array, "W N"], momenta: Float[Array, "W N"],
    ) -> None:  # fmt: skip
        """Move walkers along trajectories by the gradient without `extra`, in place.

        Arguments as for `hamiltonian.leapfrog`.
        """
        parts = (self.body, self.prior, self.optics, self.data)
        hamiltonian.leapfrog(*parts, roots, which, sizes, steps, thetas, momenta)

    def joints(self, thetas: Float[Array, "W N"]) -> Float[Array, "W 18 3"]:
        """Joints in the head frame, metres, in the order of `egocap.body.labels.LABELS`."""
        thetas = np.ascontiguousarray(thetas, float)
        out = np.empty((len(thetas), len(LABEL_POINTS), 3))
        kernel.joints(self.body, self.prior, thetas, out)
        return out


def make_log_posterior(
    detections: Detections,
    frame: int,
    rig: Rig,
    proportions: Proportions,
    config: PosteriorConfig = PosteriorConfig(),  # noqa: B008 (frozen)
    extra: LogLikelihood | None = None,
) -> LogPosterior:
    """The log posterior of one frame of detections. Raises InputError."""
    found = measure(detections, frame, rig, proportions, config)
    return LogPosterior(found, rig, proportions, config, extra)


def parameter_names(config: PosteriorConfig, views: Sequence[str]) -> tuple[str, ...]:
    """Names of all parameters in order: angles, scales (ln of the factor), rig errors."""
    scales = [f"scale_{group}" for group in SCALES] if config.bone_scales else []
    rig = [f"{view}_{error}" for view in views for error in RIG_ERRORS] if config.rig_errors else []
    return (*DOFS, *scales, *rig)


def _scale_groups() -> tuple[int, ...]:
    """Index into `SCALES` for each of `skeleton.POINTS`; UNSCALED for the head."""
    kinds = {point: i for i, group in enumerate(SCALES.values()) for point in group}
    return tuple(kinds.get(without_side(point), UNSCALED) for point in POINTS)


def readable_log_posterior(
    angles: Float[Array, "37"],
    measurement: Measurement,
    rig: Rig,
    proportions: Proportions,
    config: PosteriorConfig,
) -> float:
    """The same number for angles alone, by the readable kinematics and cameras: the oracle."""
    posture = load_posture()
    departure = angles - posture.mean
    beyond = np.maximum(0.0, np.maximum(angles - LIMITS[:, 1], LIMITS[:, 0] - angles))
    prior = -0.5 * departure @ posture.precision @ departure
    prior -= config.limit_weight * np.sum(beyond**2)
    pixels, _ = rig.project(forward(proportions, angles))
    residual = np.einsum("vlij,vlj->vli", measurement.whiten, pixels - measurement.pixels)
    squared = np.sum(residual**2, axis=-1)
    nu = config.degrees
    loss = 0.5 * squared if np.isinf(nu) else 0.5 * (nu + 2.0) * np.log1p(squared / (nu - 2.0))
    return float(prior - np.sum(measurement.weights * loss) / config.temperature)


def make_body(proportions: Proportions) -> kernel.Body:
    """The skeleton's tables and a person's bones as the kernels take them."""
    model = make_model(proportions, TrackerConfig())
    tables = {name: getattr(model, name) for name in kernel.Body._fields if name in model._fields}
    return kernel.Body(**tables, scale_group=np.array(_scale_groups()))


def make_prior(config: PosteriorConfig, views: int) -> kernel.Prior:
    """The prior of the settings."""
    posture = load_posture()
    scales = len(SCALES) if config.bone_scales else 0
    spreads = [config.bone_scale_sd] * scales
    if config.rig_errors:
        turn = np.deg2rad(config.rig_turn_sd_deg)
        spreads += views * ([turn] * 3 + [config.rig_shift_sd_m] * 3)
    return kernel.Prior(
        np.array(LIMITS), float(config.limit_weight), np.array(posture.mean),
        np.array(posture.precision), scales, np.array([s**-2.0 for s in spreads], float),
    )  # fmt: skip


def make_optics(rig: Rig, config: PosteriorConfig) -> kernel.Optics:
    """The cameras as the kernels take them."""
    lenses = [mount.camera.radial for mount in rig.mounts]
    longest = max(len(lens.coefficients) for lens in lenses)
    coefficients = np.zeros((len(lenses), longest))
    for row, lens in zip(coefficients, lenses, strict=True):
        row[: len(lens.coefficients)] = lens.coefficients
    T = rig.T_camera_head
    return kernel.Optics(
        np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]), coefficients,
        np.array([lens.middle for lens in lenses], float),
        np.array([lens.half for lens in lenses], float),
        np.array([lens.limit for lens in lenses], float),
        np.array([camera.affine for camera in rig.cameras], float),
        np.array([camera.centre for camera in rig.cameras], float),
        6 if config.rig_errors else 0,
    )  # fmt: skip
