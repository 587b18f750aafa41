"""Accuracy of the image model: quadrature, gradients, occlusion, the stochastic gradient.

The part of `egocap-eval image-model` that estimates no poses.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import DOF_COUNT, DOF_INDEX, DOFS, LIMITS, SPREAD
from egocap.cameras.rig import Rig
from egocap.cameras.rig_files import parse_rig
from egocap.image_model.image_rays import image_rays
from egocap.image_model.model import ImageModel
from egocap.image_model.stochastic import PixelSampler, gradient_scatter
from egocap.image_model.torch_energy import RayBatch, colour_energy, colour_gradient
from egocap.image_model.torch_visibility import (
    RayGaussians,
    along_rays,
    cell_visibility,
    density_at,
    pose_gaussians,
    sampled_visibility,
)
from egocap_eval.image_model.scene import Scene

BRUTE_STEP = 2e-4  # metres
SAMPLED_RAYS = (150, 600, 2400)
KEPT = (0.25, 0.5, 1.0)


def brute_visibility(met: RayGaussians, far: float = 2.6) -> Float[Array, "P G"]:
    """Equation 4 by the trapezoidal rule for both integrals, without the closed form."""
    s = torch.arange(0.0, far, BRUTE_STEP, dtype=torch.float64)
    rows = []
    for p in range(met.middle.shape[0]):
        one = RayGaussians(met.middle[p : p + 1], met.depth[p : p + 1], met.sigma)
        density = density_at(one, s[None])[0].numpy()  # (S, G)
        total = density.sum(-1)
        depth = np.concatenate([[0.0], np.cumsum((total[1:] + total[:-1]) / 2) * BRUTE_STEP])
        rows.append(np.trapezoid(np.exp(-depth)[:, None] * density, dx=BRUTE_STEP, axis=0))
    return np.reshape(rows, met.depth.shape)


def quadrature_study(rig: Rig, rng: np.random.Generator, rays: int = 60) -> dict[str, Any]:
    """Error of both quadratures against brute force, on random bodies and in the hard cases."""
    cases = {"random bodies": _random_bodies(rig, rng, rays)} | _hard_cases(rng, rays // 3)
    cases["beyond 90 degrees"] = _random_bodies(_ahead(rig), rng, rays // 3, beyond=True)
    result: dict[str, Any] = {}
    for name, met in cases.items():
        truth = brute_visibility(met)
        entry: dict[str, Any] = {"rays": len(truth)}
        for samples in (3, 5, 7, 9, 13, 21):
            found = sampled_visibility(met, samples).numpy()
            entry[f"samples_{samples}"] = _errors(found, truth)
        for cell in (0.04, 0.03, 0.02, 0.01, 0.005):
            entry[f"cells_{1000 * cell:.0f}mm"] = _errors(cell_visibility(met, cell).numpy(), truth)
        result[name] = entry
    return result


def gradient_study(body: GaussianBody, rig: Rig, rng: np.random.Generator) -> dict[str, Any]:
    """Derivative by every angle: reference by central differences, kernel by the reference."""
    rays = image_rays(rig, 24, 24)
    angles = _random_pose(rng, 0.5)
    model = ImageModel(body, rays, cutoff=1e-5)
    hsv = rng.uniform(size=(len(rays), 3))
    colours = np.ascontiguousarray(model.measure.features(hsv), np.float32)
    batch = RayBatch.from_rays(rays, colours.astype(float))
    _, gradient = colour_gradient(body, batch, torch.as_tensor(angles), model.measure)
    exact = gradient.numpy()
    h = 1e-5
    central = np.zeros(DOF_COUNT)
    with torch.no_grad():
        for d in range(DOF_COUNT):
            ends = []
            for sign in (1.0, -1.0):
                moved = angles.copy()
                moved[d] += sign * h
                ends.append(
                    colour_energy(body, batch, torch.as_tensor(moved), model.measure).item()
                )
            central[d] = (ends[0] - ends[1]) / (2 * h)
    fast = model.evaluate(angles, colours).gradient
    scale = np.abs(exact).max()
    return {
        "central_differences_max_error": float(np.abs(central - exact).max() / scale),
        "kernel_max_error": float(np.abs(fast - exact).max() / scale),
        "kernel_error_by_angle": dict(
            zip(DOFS, (np.abs(fast - exact) / scale).round(7).tolist(), strict=True)
        ),
    }


def occlusion_study(body: GaussianBody, rig: Rig, steps: int = 161) -> dict[str, Any]:
    """Energy and slope while the left forearm moves across the trunk: both must be continuous.

    The body has red arms and a blue trunk, every pixel of the image is red.
    """
    colour = np.tile([0.62, 0.8, 0.6], (len(body.parts), 1))
    colour[[("arm" in part or "hand" in part) for part in body.parts]] = (0.0, 0.9, 0.8)
    model = ImageModel(body.with_colour(colour), image_rays(rig, 128, 128))
    red = np.tile([0.0, 0.9, 0.8], (len(model.rays), 1))
    colours = np.ascontiguousarray(model.measure.features(red), np.float32)
    swing, start = DOF_INDEX["left_shoulder_rotation"], np.zeros(DOF_COUNT)
    start[DOF_INDEX["left_elbow_flexion"]] = np.deg2rad(90.0)
    start[DOF_INDEX["left_shoulder_raise"]] = np.deg2rad(25.0)
    sweep = np.deg2rad(np.linspace(-80.0, 40.0, steps))
    energies, slopes = [], []
    for angle in sweep:
        start[swing] = angle
        found = model.evaluate(start, colours)
        energies.append(found.energy)
        slopes.append(found.gradient[swing])
    energy, slope = np.array(energies), np.array(slopes)
    predicted = (slope[1:] + slope[:-1]) / 2 * np.diff(sweep)
    return {
        "angle_deg": np.rad2deg(sweep).round(3).tolist(),
        "energy": energy.round(4).tolist(),
        "slope": slope.round(3).tolist(),
        "largest_energy_step_share": float(np.abs(np.diff(energy)).max() / np.ptp(energy)),
        "largest_slope_step_share": float(np.abs(np.diff(slope)).max() / np.ptp(slope)),
        "energy_against_slope": float(np.abs(np.diff(energy) - predicted).max() / np.ptp(energy)),
    }


def stochastic_study(scene: Scene, rng: np.random.Generator, draws: int = 150) -> dict[str, Any]:
    """Scatter of the stochastic gradient about the full gradient, and its bias.

    At a frame's true pose turned by up to 5 degrees; `scatter` is the root mean square distance as
    a share of the full gradient, with rays drawn towards the outline or evenly; `bias` the distance
    of the estimates' mean, and `bias_expected` what that would be from scatter alone.
    """
    t = len(scene.poses) // 2
    pose = scene.poses[t] + np.deg2rad(5.0) * rng.uniform(-1.0, 1.0, DOF_COUNT)
    scene.term.reset_background()
    colours = scene.term.set_images(scene.sequence.images(t), pose)
    model = scene.term.model
    aimed, evenly = PixelSampler(model), PixelSampler(model)
    aimed.aim(colours, pose)
    result: dict[str, Any] = {"scene": scene.name, "frame": t, "draws": draws}
    for rays in SAMPLED_RAYS:
        for keep in KEPT:
            result[f"rays_{rays}_keep_{keep:g}"] = {
                name: round(gradient_scatter(s, colours, pose, rays, keep, draws, rng), 4)
                for name, s in (("scatter", aimed), ("scatter_even", evenly))
            }
    exact = model.evaluate(pose, colours).gradient
    drawn = np.array(
        [aimed.estimate(colours, pose, 600, 0.5, rng).gradient for _ in range(4 * draws)]
    )
    size = np.linalg.norm(exact)
    result["bias"] = round(float(np.linalg.norm(drawn.mean(0) - exact) / size), 4)
    result["bias_expected"] = round(float(np.sqrt(drawn.var(0).sum() / len(drawn)) / size), 4)
    return result


def _errors(found: Float[Array, "P G"], truth: Float[Array, "P G"]) -> dict[str, float]:
    """Largest and mean error; the mean is a ray's summed error over its summed visibility."""
    wrong = np.abs(found - truth)
    return {
        "max": float(f"{wrong.max():.2e}"),
        "relative": float(f"{wrong.sum() / truth.sum():.2e}"),
    }


def _random_pose(rng: np.random.Generator, extent: float) -> Float[Array, "37"]:
    return np.clip(extent * SPREAD * rng.normal(size=DOF_COUNT), LIMITS[:, 0], LIMITS[:, 1])


def _ahead(rig: Rig) -> Rig:
    """The rig with lenses of 280 degrees facing straight ahead: the body is behind them."""
    lens = {"model": "equidistant", "width": 256, "height": 256, "fov": 280.0}
    forward, left, up = rig.T_head_camera[0, :3, 3]
    stereo = {"baseline": 2 * left, "forward": forward, "up": up, "pitch": 0.0}
    return parse_rig({"name": "ahead", "lens": lens, "stereo": stereo}, "image-model")


def _random_bodies(
    rig: Rig, rng: np.random.Generator, count: int, beyond: bool = False
) -> RayGaussians:
    """Rays that meet random bodies in random poses; `beyond`: more than 90 degrees off axis."""
    rays = image_rays(rig, 128, 128)
    ahead = (rays.direction * rig.T_head_camera[rays.view, :3, 2]).sum(-1)
    usable = np.flatnonzero(ahead < 0) if beyond else np.arange(len(rays))
    middles, depths = [], []
    for _ in range(4):
        body = GaussianBody.from_proportions(Proportions.from_lengths(rng.uniform(1.5, 1.95)))
        centres = pose_gaussians(body, torch.as_tensor(_random_pose(rng, 0.8)))
        pick = rng.choice(usable, 4000, replace=False)
        met = along_rays(
            centres, torch.tensor(body.sigma), torch.tensor(body.density),
            torch.tensor(rays.origins[rays.view[pick]]), torch.tensor(rays.direction[pick]),
        )  # fmt: skip
        hit = torch.nonzero(met.depth.sum(-1) > 0.05)[: count // 4, 0]
        middles.append(met.middle[hit])
        depths.append(met.depth[hit])
    # Bodies differ in sigma; quadratures can be compared on any 1-D Gaussians, so one row is used.
    return RayGaussians(torch.cat(middles), torch.cat(depths), torch.tensor(body.sigma))


def _hard_cases(rng: np.random.Generator, count: int) -> dict[str, RayGaussians]:
    """A few Gaussians along the rays where a quadrature may fail."""
    sigma = torch.tensor([0.03, 0.05, 0.04], dtype=torch.float64)

    def drawn(low: float, high: float) -> torch.Tensor:
        return torch.as_tensor(rng.uniform(low, high, (count, 3)))

    depth = drawn(0.2, 4.0)
    close = drawn(-2.0, 2.0) * sigma
    same = drawn(0.3, 1.5)[:, :1].expand(-1, 3)
    apart = drawn(0.3, 1.5)
    return {
        "camera within 2 sigma": RayGaussians(close, depth, sigma),
        "coincident": RayGaussians(same.contiguous(), depth, sigma[:1].expand(3).contiguous()),
        "opaque": RayGaussians(apart, 4.0 * depth, sigma),
    }
