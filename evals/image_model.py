"""Studies of the volumetric image model: quadrature, gradients, occlusion, basin of attraction.

    python -m evals.image_model SEQ... --live SEQ... --out evals/results/image_model.json

SEQ are simulated sequences, of several people and motions; those of --live are followed by colour
alone. Colours are learned in five frames of a sequence at the true pose, as personalisation would;
poses are searched without the truth, which only judges them.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body import Proportions
from egocap.detect.simulated import parse_source, simulate_detections
from egocap.gaussians import GaussianBody
from egocap.labels import EVALUATED, UPPER
from egocap.rig import Rig
from egocap.rig_files import parse_rig
from egocap.sequence import VISIBLE, Sequence
from egocap.skeleton import DOF_COUNT, DOF_INDEX, DOFS, LIMITS, SPREAD, forward
from egocap.track.appearance import RayBatch, colour_energy, colour_gradient
from egocap.track.colour import PAPER, ColourMeasure
from egocap.track.colour_term import ColourTerm, ColourTermConfig
from egocap.track.colouring import colour_body
from egocap.track.config import TrackerConfig
from egocap.track.image_model import ImageModel
from egocap.track.image_rays import image_rays
from egocap.track.image_solver import (
    UPPER_BODY,
    ImageSolver,
    ImageSolverConfig,
    track_colours,
)
from egocap.track.inverse import nearest_angles
from egocap.track.observations import Observations, observe
from egocap.track.palette import learn_palette
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
LEARNED = 5
LIVE_TERM = ColourTermConfig(size=96, weight=0.03)
LIVE_PRIORS = TrackerConfig(zeta=0.7, speed=8.0)
"""Colour alone must follow fast hands from frame to frame."""


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


def basin_study(
    scenes: list[Scene], trials: int, rng: np.random.Generator
) -> dict[str, dict[str, dict[str, float]]]:
    """Share of perturbed poses that come back to under 30 mm, by what is perturbed and known.

    Every angle is drawn evenly from plus or minus the size; `trials` are those of a scene.
    `visible` counts only joints that a view sees, as colour cannot know of others. The last two are
    the paper's measure, which knows of no background.
    """
    tasks: dict[str, Callable[[Scene, float], Trial]] = {
        "colour, upper body": lambda scene, size: scene.trial(size, rng, UPPER_BODY),
        "colour, all angles": lambda scene, size: scene.trial(size, rng),
        "colour and detections": lambda scene, size: scene.trial(size, rng, pixels=2.0),
        "detections": lambda scene, size: scene.trial(size, rng, pixels=2.0, weight=0.0),
        "paper's colour, upper body": lambda scene, size: scene.trial(
            size, rng, UPPER_BODY, measure=PAPER
        ),
        "paper's colour and detections": lambda scene, size: scene.trial(
            size, rng, pixels=2.0, measure=PAPER
        ),
    }
    return {
        name: {
            f"{size:.0f}_deg": _summary([run(s, size) for s in scenes for _ in range(trials)])
            for size in PERTURBATIONS_DEG
        }
        for name, run in tasks.items()
    }


def detection_study(scenes: list[Scene], frames: int, rng: np.random.Generator) -> dict[str, Any]:
    """Mean error with and without colour beside detections of 2 and 4 pixels at 640 x 512.

    Every frame is solved on its own, first from detections alone, starting 5 degrees off; colour
    starts from what they find.
    """
    result: dict[str, Any] = {}
    for pixels in (2.0, 4.0):
        entry: dict[str, Any] = {}
        for scene in scenes:
            picked = np.linspace(0, len(scene.poses) - 1, frames).round().astype(int)
            rows = [scene.compare(int(t), pixels, rng) for t in picked]
            without, with_ = (np.mean([row[k] for row in rows], 0) for k in (0, 1))
            entry[scene.name] = {
                "detections_mm": round(1e3 * float(without[0]), 1),
                "with_colour_mm": round(1e3 * float(with_[0]), 1),
                "detections_visible_mm": round(1e3 * float(without[1]), 1),
                "with_colour_visible_mm": round(1e3 * float(with_[1]), 1),
            }
        names = next(iter(entry.values()))
        entry["mean"] = {
            name: round(float(np.mean([e[name] for e in entry.values()])), 1) for name in names
        }
        result[f"simulated_{pixels:.0f}_px"] = entry
    return result


def live_study(folder: Path, frames: int) -> dict[str, Any]:
    """The paper's live test: the upper body by colour alone, from a known first pose."""
    scene = Scene(folder)
    term = ColourTerm(scene.body, scene.sequence.rig, scene.palette, LIVE_TERM)
    solver = ImageSolver(
        term.model, ImageSolverConfig(lambda_colour=LIVE_TERM.weight), LIVE_PRIORS, UPPER_BODY
    )
    count = min(frames, len(scene.poses))

    def seen():
        for t in range(count):
            yield term.see(scene.sequence.frame(t).images, scene.poses[0] if t == 0 else None)

    found = track_colours(solver, seen(), scene.poses[0], scene.sequence.manifest.fps)
    errors = 1e3 * np.array([scene.errors(f.angles, t)[UPPER] for t, f in enumerate(found)])
    return {
        "frames": count,
        "mean_mm": round(float(errors.mean()), 1),
        "median_mm": round(float(np.median(errors)), 1),
        "last_50_mm": round(float(errors[-50:].mean()), 1),
        "worst_frame_mm": round(float(errors.mean(1).max()), 1),
        "steps_a_frame": round(float(np.mean([f.steps for f in found])), 2),
    }


@dataclass(frozen=True)
class Trial:
    """Mean errors before and after solving, metres."""

    before: float
    after: float
    visible: float  # of the joints that a view sees, after


class Scene:
    """Frames of a sequence, a body in its colours, detections of it.

    Colours are learned in `LEARNED` frames spread over the sequence, at their true poses: the few
    poses of a personalisation.
    """

    def __init__(self, folder: Path) -> None:
        self.sequence = sequence = Sequence(folder)
        self.name = folder.name
        truth = sequence.truth
        self.joints = truth.joints_head
        self.seen = (truth.visibility == VISIBLE).any(1)  # (T, 18)
        self.poses = [nearest_angles(sequence.proportions, joints) for joints in self.joints]
        rays = image_rays(sequence.rig, 128, 128)
        body = GaussianBody.from_proportions(sequence.proportions)
        spread = np.linspace(0, len(self.poses) - 1, LEARNED).round().astype(int)
        shown = [(sequence.frame(int(t)).images, self.poses[t]) for t in spread]
        self.palette = learn_palette(body, rays, shown)
        self.body = colour_body(body, rays, *shown[0])
        self.term = ColourTerm(self.body, sequence.rig, self.palette)
        self.paper = ImageModel(self.body, rays, measure=PAPER)
        self._observations: dict[float, Observations] = {}

    def observations(self, pixels: float) -> Observations:
        """Simulated detections of an accuracy."""
        if pixels not in self._observations:
            truth, camera = self.sequence.truth, self.sequence.rig.mounts[0].camera
            found = simulate_detections(
                truth.joints_2d, truth.visibility == VISIBLE, truth.in_view, truth.time,
                (camera.width, camera.height), parse_source(f"simulated:{pixels}"),
                np.random.default_rng(0),
            )  # fmt: skip
            self._observations[pixels] = observe(
                found, self.sequence.rig, self.sequence.proportions, TrackerConfig()
            )
        return self._observations[pixels]

    def solve(
        self,
        t: int,
        start: Float[Array, "37"],
        free: Bool[Array, "37"] | None = None,
        pixels: float | None = None,
        weight: float | None = None,
        measure: ColourMeasure | None = None,
    ) -> Float[Array, "37"]:
        """The pose at a frame from a start; without `measure` by the palette."""
        model = self.term.model if measure is None else self.paper
        images = self.sequence.frame(t).images
        if measure is None:
            self.term.forget()
            colours = self.term.see(images, start)
        else:
            colours = model.colours(images)
        alone = ImageSolverConfig().lambda_colour
        usual = alone if pixels is None else ColourTermConfig().weight
        config = ImageSolverConfig(
            lambda_colour=usual if weight is None else weight, iterations=30, tolerance=1e-4
        )
        known = None if pixels is None else self.observations(pixels)
        return ImageSolver(model, config, free=free).solve(
            colours, start, observations=known, frame=t
        ).angles  # fmt: skip

    def trial(
        self,
        size_deg: float,
        rng: np.random.Generator,
        free: Bool[Array, "37"] | None = None,
        pixels: float | None = None,
        weight: float | None = None,
        measure: ColourMeasure | None = None,
    ) -> Trial:
        """Perturb a random frame's pose, solve, and compare with the truth."""
        t = int(rng.integers(len(self.poses)))
        shift = np.deg2rad(size_deg) * rng.uniform(-1.0, 1.0, DOF_COUNT)
        start = self.poses[t] + (shift if free is None else np.where(free, shift, 0.0))
        found = self.solve(t, start, free, pixels, weight, measure)
        judged = np.array(UPPER if free is not None else EVALUATED)
        before, after = (self.errors(angles, t)[judged] for angles in (start, found))
        visible = after[self.seen[t][judged]]
        return Trial(float(before.mean()), float(after.mean()), float(visible.mean()))

    def compare(
        self, t: int, pixels: float, rng: np.random.Generator
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Error of all and of the visible joints, without and with colour beside detections."""
        start = self.poses[t] + np.deg2rad(5.0) * rng.uniform(-1.0, 1.0, DOF_COUNT)
        without = self.solve(t, start, pixels=pixels, weight=0.0)
        with_ = self.solve(t, without, pixels=pixels)
        judged, seen = np.array(EVALUATED), self.seen[t]
        both = [self.errors(angles, t)[judged] for angles in (without, with_)]
        first, second = ((float(e.mean()), float(e[seen[judged]].mean())) for e in both)
        return first, second

    def errors(self, angles: Float[Array, "37"], t: int) -> Float[Array, "18"]:
        """Distance of every joint from the truth, metres."""
        joints = forward(self.sequence.proportions, angles)
        return np.linalg.norm(joints - self.joints[t], axis=-1)


def _summary(trials: list[Trial]) -> dict[str, float]:
    before, after, visible = (
        np.array([getattr(t, n) for t in trials]) for n in ("before", "after", "visible")
    )
    return {
        "start_mm": round(1e3 * float(before.mean()), 1),
        "median_mm": round(1e3 * float(np.median(after)), 1),
        "median_visible_mm": round(1e3 * float(np.median(visible)), 1),
        "share_under_30_mm": float(np.mean(after < CLOSE_M)),
        "share_visible_under_30_mm": float(np.mean(visible < CLOSE_M)),
    }


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
    parser.add_argument("sequences", type=Path, nargs="+")
    parser.add_argument("--live", type=Path, nargs="*", default=[])
    parser.add_argument("--live-frames", type=int, default=250)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--trials", type=int, default=8, help="of every kind, a sequence")
    parser.add_argument("--frames", type=int, default=8, help="to compare, of every sequence")
    words = parser.parse_args()
    rng = np.random.default_rng(0)
    scenes = [Scene(folder) for folder in words.sequences]
    rig = scenes[0].sequence.rig
    body = GaussianBody.from_proportions(Proportions.from_lengths())
    coloured = body.with_colour(rng.uniform(0.05, 0.95, (len(body.parts), 3)))
    result = {
        "quadrature": quadrature_study(rig, rng),
        "gradients": gradient_study(coloured, rig, rng),
        "occlusion": occlusion_study(body, rig),
        "basin": basin_study(scenes, words.trials, rng),
        "beside_detections": detection_study(scenes, words.frames, rng),
        "live": {folder.name: live_study(folder, words.live_frames) for folder in words.live},
    }
    print(json.dumps({k: v for k, v in result.items() if k != "occlusion"}, indent=1))
    if words.out:
        from evals.record import save_result

        save_result(
            words.out, result, shlex.join(["python", "-m", "evals.image_model", *sys.argv[1:]])
        )


if __name__ == "__main__":
    main()
