"""Studies of the volumetric image model: quadrature, gradients, occlusion, basin of attraction.

    python -m evals.image_model SEQ --out evals/results/image_model.json

SEQ is a simulated sequence. Colours are read off its first frame at the true pose, as
personalisation would; poses are searched without the truth, which only judges them.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.gaussians import GaussianBody
from egocap.labels import EVALUATED, UPPER
from egocap.rig import Rig
from egocap.rig_files import parse_rig
from egocap.sequence import VISIBLE, Sequence
from egocap.skeleton import DOF_COUNT, DOF_INDEX, DOFS, LIMITS, SPREAD, forward
from egocap.track.appearance import RayBatch, colour_energy, colour_gradient
from egocap.track.colouring import colour_body
from egocap.track.image_model import ImageModel
from egocap.track.image_rays import image_rays
from egocap.track.image_solver import UPPER_BODY, ImageSolver, ImageSolverConfig
from egocap.track.inverse import nearest_angles
from egocap.track.posing import pose_gaussians
from egocap.track.visibility import (
    RayGaussians,
    along_rays,
    cell_visibility,
    density_at,
    sampled_visibility,
)

BRUTE_STEP = 2e-4  # metres
PERTURBATIONS_DEG = (2.0, 5.0, 10.0, 15.0, 20.0)
CLOSE_M = 0.03


def brute_visibility(met: RayGaussians, far: float = 2.6) -> Float[Array, "P G"]:
    """Equation 4 by trapezoids of both integrals: no error function, no trick."""
    s = torch.arange(0.0, far, BRUTE_STEP, dtype=torch.float64)
    rows = []
    for p in range(met.middle.shape[0]):
        one = RayGaussians(met.middle[p : p + 1], met.depth[p : p + 1], met.sigma)
        density = density_at(one, s[None])[0].numpy()  # (S, G)
        total = density.sum(-1)
        depth = np.concatenate([[0.0], np.cumsum((total[1:] + total[:-1]) / 2) * BRUTE_STEP])
        rows.append(np.trapezoid(np.exp(-depth)[:, None] * density, dx=BRUTE_STEP, axis=0))
    return np.array(rows)


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
    batch = RayBatch.of(rays, colours.astype(float))
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
    """Energy and slope while the left forearm sweeps before the trunk: both must be continuous.

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


def basin_study(folder: Path, trials: int, rng: np.random.Generator) -> dict[str, Any]:
    """Share of perturbed poses that come back to under 30 mm, by what is perturbed and known.

    Every angle is drawn evenly from plus or minus the size. `visible` counts only joints that a
    view sees, as colour cannot know of others.
    """
    scene = Scene(folder)
    tasks: dict[str, Callable[[float], dict[str, float]]] = {
        "colour, upper body": lambda size: scene.returns(size, trials, rng, UPPER_BODY, False),
        "colour, all angles": lambda size: scene.returns(size, trials, rng, None, False),
        "colour and detections": lambda size: scene.returns(size, trials, rng, None, True),
        "detections": lambda size: scene.returns(size, trials, rng, None, True, colour=0.0),
    }
    return {
        name: {f"{size:.0f}_deg": run(size) for size in PERTURBATIONS_DEG}
        for name, run in tasks.items()
    }


class Scene:
    """Frames of a sequence, a body in their colours, detections of 2 pixels at 640 x 512."""

    def __init__(self, folder: Path) -> None:
        from egocap.detect.simulated import parse_source, simulate_detections
        from egocap.track.config import TrackerConfig
        from egocap.track.observations import observe

        self.sequence = sequence = Sequence(folder)
        truth = sequence.truth
        self.joints = truth.joints_head
        self.seen = (truth.visibility == VISIBLE).any(1)  # (T, 18)
        self.poses = [nearest_angles(sequence.proportions, joints) for joints in self.joints]
        self.rays = image_rays(sequence.rig, 128, 128)
        plain = GaussianBody.from_proportions(sequence.proportions)
        first = sequence.frame(0).images
        self.body = colour_body(plain, self.rays, first, self.poses[0])
        self.model = ImageModel(self.body, self.rays)
        self.colours = [self.model.colours(frame.images) for frame in sequence]
        camera = sequence.rig.mounts[0].camera
        found = simulate_detections(
            truth.joints_2d, truth.visibility == VISIBLE, truth.in_view, truth.time,
            (camera.width, camera.height), parse_source("simulated:2"), np.random.default_rng(0),
        )  # fmt: skip
        self.observations = observe(found, sequence.rig, sequence.proportions, TrackerConfig())

    def returns(self, size_deg, trials, rng, free, detected, colour=None) -> dict[str, float]:
        """Perturb, solve, and compare with the truth."""
        default = ImageSolverConfig()
        weight = default.lambda_colour if colour is None else colour
        solver = ImageSolver(
            self.model, ImageSolverConfig(lambda_colour=weight, iterations=30, tolerance=1e-4),
            free=free,
        )  # fmt: skip
        judged = np.array(UPPER if free is not None else EVALUATED)
        before, after, visible = [], [], []
        for _ in range(trials):
            t = int(rng.integers(len(self.poses)))
            shift = np.deg2rad(size_deg) * rng.uniform(-1.0, 1.0, DOF_COUNT)
            start = self.poses[t] + np.where(solver.free, shift, 0.0)
            known = self.observations if detected else None
            solved = solver.solve(self.colours[t], start, observations=known, frame=t)
            wrong = [self._errors(angles, t) for angles in (start, solved.angles)]
            before.append(wrong[0][judged].mean())
            after.append(wrong[1][judged].mean())
            visible.append(wrong[1][judged][self.seen[t][judged]].mean())
        return {
            "start_mm": round(1e3 * float(np.mean(before)), 1),
            "median_mm": round(1e3 * float(np.median(after)), 1),
            "median_visible_mm": round(1e3 * float(np.median(visible)), 1),
            "share_under_30_mm": float(np.mean(np.array(after) < CLOSE_M)),
            "share_visible_under_30_mm": float(np.mean(np.array(visible) < CLOSE_M)),
        }

    def _errors(self, angles: Float[Array, "37"], t: int) -> Float[Array, "18"]:
        joints = forward(self.sequence.proportions, angles)
        return np.linalg.norm(joints - self.joints[t], axis=-1)


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
    """The rig with lenses of 280 degrees that look straight ahead: the body is behind them."""
    lens = {"model": "equidistant", "width": 256, "height": 256, "fov": 280.0}
    forward, left, up = rig.T_head_camera[0, :3, 3]
    stereo = {"baseline": 2 * left, "forward": forward, "up": up, "pitch": 0.0}
    return parse_rig({"name": "ahead", "lens": lens, "stereo": stereo}, "the study's own rig")


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
    # Bodies differ in sigma; any 1-D Gaussians do to compare quadratures, so one row serves all.
    return RayGaussians(torch.cat(middles), torch.cat(depths), torch.tensor(body.sigma))


def _hard_cases(rng: np.random.Generator, count: int) -> dict[str, RayGaussians]:
    """Few Gaussians in the places where a quadrature may fail, as seen along the rays."""
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


def main() -> None:
    """Run all studies; print and write their numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--trials", type=int, default=20)
    words = parser.parse_args()
    rng = np.random.default_rng(0)
    rig = Sequence(words.sequence).rig
    body = GaussianBody.from_proportions(Proportions.from_lengths())
    coloured = body.with_colour(rng.uniform(0.05, 0.95, (len(body.parts), 3)))
    result = {
        "quadrature": quadrature_study(rig, rng),
        "gradients": gradient_study(coloured, rig, rng),
        "occlusion": occlusion_study(body, rig),
        "basin": basin_study(words.sequence, words.trials, rng),
    }
    print(json.dumps({k: v for k, v in result.items() if k != "occlusion"}, indent=1))
    if words.out:
        from evals.record import save_result

        save_result(
            words.out, result, shlex.join(["python", "-m", "evals.image_model", *sys.argv[1:]])
        )


if __name__ == "__main__":
    main()
