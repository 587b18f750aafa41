"""Times of the volumetric image model, beside its torch reference on the same rays.

    python benchmarks/image_model.py SEQ                     # a simulated sequence
    python benchmarks/image_model.py SEQ --out FILE.json     # and write the numbers
    python benchmarks/image_model.py SEQ --device cuda       # and many poses at once, on a GPU

The pose is the one nearest to the truth of frame 0, the colours those of that frame. `ms` is the
smallest of many calls; `cpu_ms` is the mean processor time of all threads, which other work on the
machine disturbs less. The reference is `egocap.track.appearance` with autograd, single precision,
on the rays that meet the body only: on all rays it would take several times longer.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SIZE = (128, 128)
LIVE_SIZE, LIVE_TERM = (120, 100), 96
STOCHASTIC_RAYS, KEEP = 600, 0.5
FIRST_CALL = """
import time, numpy as np
started = time.perf_counter()
from egocap.body import Proportions
from egocap.gaussians import GaussianBody
from egocap.rig import load_rig
from egocap.track.image_model import ImageModel
from egocap.track.image_rays import image_rays
imported = time.perf_counter()
body = GaussianBody.from_proportions(Proportions.from_lengths())
rays = image_rays(load_rig("scenes/rigs/egorig1.toml"), 32, 32)
ImageModel(body, rays).evaluate(np.zeros(37), np.zeros((len(rays), 3), np.float32), curvature=True)
print(imported - started, time.perf_counter() - imported)
"""


def best(call: Callable[[], Any], repeats: int = 60) -> dict[str, float]:
    """Smallest and median wall time, and mean processor time, of a call in milliseconds."""
    walls, busy = [], time.process_time()
    for _ in range(repeats):
        wall = time.perf_counter()
        call()
        walls.append(time.perf_counter() - wall)
    busy = time.process_time() - busy
    return {
        "ms": 1e3 * min(walls),
        "median_ms": 1e3 * float(np.median(walls)),
        "cpu_ms": 1e3 * busy / repeats,
    }


class Bench:
    """A coloured body before a frame of a sequence."""

    def __init__(self, folder: str) -> None:
        from egocap.gaussians import GaussianBody
        from egocap.sequence import Sequence
        from egocap.track.colouring import colour_body
        from egocap.track.image_rays import image_rays
        from egocap.track.inverse import nearest_angles

        self.sequence = Sequence(folder)
        self.angles = nearest_angles(self.sequence.proportions, self.sequence.truth.joints_head[0])
        self.images = self.sequence.frame(0).images
        rays = image_rays(self.sequence.rig, *SIZE)
        plain = GaussianBody.from_proportions(self.sequence.proportions)
        self.body = colour_body(plain, rays, self.images, self.angles)

    def model(self, size: tuple[int, int] = SIZE, threads: int | None = None):
        """A model at a size, and the frame's colours along its rays."""
        from egocap.track.image_model import ImageModel
        from egocap.track.image_rays import image_rays

        model = ImageModel(self.body, image_rays(self.sequence.rig, *size), threads=threads)
        return model, model.colours(self.images)

    def kernel(self) -> dict[str, Any]:
        """The compiled model."""
        model, colours = self.model()
        alone, _ = self.model(threads=1)
        met = int((model.pixel_energies(self.angles, colours)[0] != 0).sum())
        return {
            "rays": len(model.rays), "rays_that_meet_the_body": met,
            "energy_and_gradient": best(lambda: model.evaluate(self.angles, colours)),
            "one_thread": best(lambda: alone.evaluate(self.angles, colours)),
            "with_gauss_newton": best(
                lambda: model.evaluate(self.angles, colours, curvature=True)
            ),
            "colours_of_a_frame": best(lambda: model.colours(self.images)),
        }  # fmt: skip

    def stochastic(self) -> dict[str, Any]:
        """One step of the stochastic variant, and the scatter of its gradient."""
        from egocap.track.stochastic import PixelSampler

        model, colours = self.model(LIVE_SIZE)
        alone, _ = self.model(LIVE_SIZE, threads=1)
        sampler, rng = PixelSampler(model), np.random.default_rng(0)
        sampler.aim(colours, self.angles)
        exact = model.evaluate(self.angles, colours).gradient

        def step() -> np.ndarray:
            found = sampler.estimate(colours, self.angles, STOCHASTIC_RAYS, KEEP, rng)
            return found.gradient

        def evenly() -> np.ndarray:
            even = PixelSampler(model)  # never aimed: all rays alike
            return even.estimate(colours, self.angles, STOCHASTIC_RAYS, KEEP, rng).gradient

        def scatter(draw: Callable[[], np.ndarray]) -> float:
            squared = np.mean([np.sum((draw() - exact) ** 2) for _ in range(200)])
            return float(np.sqrt(squared) / np.linalg.norm(exact))

        times = best(step, 300)
        one = PixelSampler(alone)
        one.aim(colours, self.angles)
        single = best(lambda: one.estimate(colours, self.angles, STOCHASTIC_RAYS, KEEP, rng), 300)
        return {
            "rays": STOCHASTIC_RAYS, "keep": KEEP, "step": times, "one_thread": single,
            "gradient_scatter": scatter(step), "gradient_scatter_even": scatter(evenly),
        }  # fmt: skip

    def reference(self, kernel_ms: float) -> dict[str, Any]:
        """The torch reference on the rays that meet the body."""
        import torch

        from egocap.track.appearance import RayBatch, colour_gradient

        model, colours = self.model()
        met = torch.as_tensor(np.flatnonzero(model.pixel_energies(self.angles, colours)[0]))
        batch = RayBatch.of(model.rays, colours, torch.float32)[met]
        angles = torch.as_tensor(self.angles, dtype=torch.float32)
        times = best(lambda: colour_gradient(self.body, batch, angles, model.measure), 2)
        return {**times, "times_slower": times["ms"] / kernel_ms}

    def term(self, size: int = SIZE[0]):
        """The body's colours against the background's, learned in five frames."""
        from egocap.track.colour_term import ColourTerm, ColourTermConfig
        from egocap.track.image_rays import image_rays
        from egocap.track.inverse import nearest_angles
        from egocap.track.palette import learn_palette

        sequence = self.sequence
        truth = sequence.truth.joints_head
        shown = []
        for t in np.linspace(0, len(sequence) - 1, 5).round().astype(int):
            angles = nearest_angles(sequence.proportions, truth[t])
            shown.append((sequence.frame(int(t)).images, angles))
        palette = learn_palette(self.body, image_rays(sequence.rig, *SIZE), shown)
        return ColourTerm(self.body, sequence.rig, palette, ColourTermConfig(size, weight=0.03))

    def palette(self) -> dict[str, Any]:
        """The kernel with colours by bins, and what a frame costs besides."""
        term = self.term()
        colours = term.see(self.images, self.angles)
        H, g = np.zeros((37, 37)), np.zeros(37)
        return {
            "energy_and_gradient": best(lambda: term.model.evaluate(self.angles, colours)),
            "with_gauss_newton": best(lambda: term.add(self.angles, H, g)),
            "a_frame": best(lambda: term.see(self.images)),
        }

    def live(self) -> dict[str, Any]:
        """Colour-only tracking of the upper body over the sequence, images in memory."""
        from egocap.labels import UPPER
        from egocap.skeleton import forward
        from egocap.track.config import TrackerConfig
        from egocap.track.image_solver import (
            UPPER_BODY,
            ImageSolver,
            ImageSolverConfig,
            track_colours,
        )

        term = self.term(LIVE_TERM)
        solver = ImageSolver(
            term.model, ImageSolverConfig(lambda_colour=term.config.weight),
            TrackerConfig(zeta=0.7, speed=8.0), UPPER_BODY,
        )  # fmt: skip
        images = [frame.images for frame in self.sequence]
        fps = self.sequence.manifest.fps
        found = {}
        for name, seed in (("gauss_newton", None), ("stochastic", 0)):
            rates, poses = [], []
            for _ in range(3):
                term.forget()
                rng = None if seed is None else np.random.default_rng(seed)
                started = time.perf_counter()
                seen = (term.see(pair, None if t else self.angles) for t, pair in enumerate(images))
                poses = track_colours(solver, seen, self.angles, fps, rng)
                rates.append(len(images) / (time.perf_counter() - started))
            joints = forward(self.sequence.proportions, np.array([p.angles for p in poses]))
            errors = np.linalg.norm(joints - self.sequence.truth.joints_head, axis=-1)
            found[name] = {
                "frames_per_second": max(rates),
                "upper_body_error_mm": float(1e3 * errors[:, UPPER].mean()),
                "steps": float(np.mean([p.steps for p in poses])),
            }
        return found

    def batched(self, device: str, poses: int) -> dict[str, Any]:
        """Many poses at once by the torch path; energy and gradient."""
        import torch

        from egocap.track.appearance import RayBatch, colour_gradient

        model, colours = self.model()
        batch = RayBatch.of(model.rays, colours, torch.float32, device)
        angles = torch.as_tensor(np.tile(self.angles, (poses, 1)), dtype=torch.float32).to(device)

        def call() -> None:
            colour_gradient(self.body, batch, angles, model.measure, chunk=max(1, 2048 // poses))
            if device == "cuda":
                torch.cuda.synchronize()

        times = best(call, 3)
        return {"device": device, "poses": poses, **times, "ms_a_pose": times["ms"] / poses}


def first_call() -> dict[str, float]:
    """Seconds to import and to be ready, without and with compiled code on disk."""
    root = Path(__file__).resolve().parents[1]
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        runs = [
            subprocess.run([sys.executable, "-c", FIRST_CALL], env=environment, cwd=root,
                           capture_output=True, text=True, check=True).stdout.split()
            for _ in range(2)
        ]  # fmt: skip
    (imported, compiled), (_, loaded) = ((float(x) for x in run) for run in runs)
    return {"import_s": imported, "compile_s": compiled, "from_cache_s": loaded}


def main() -> None:
    """Measure, print, and write when asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequence")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--device", choices=("cpu", "cuda"))
    parser.add_argument("--poses", type=int, default=16)
    words = parser.parse_args()
    bench = Bench(words.sequence)
    kernel = bench.kernel()
    result = {
        "kernel": kernel,
        "palette": bench.palette(),
        "stochastic": bench.stochastic(),
        "reference": bench.reference(kernel["energy_and_gradient"]["ms"]),
        "live": bench.live(),
        "start": first_call(),
    }
    if words.device:
        result["batched"] = bench.batched(words.device, words.poses)
    print(json.dumps(result, indent=2))
    if words.out:
        from evals.record import save_result

        result["load"] = list(os.getloadavg())
        command = f"python benchmarks/image_model.py SEQ --out {words.out}"
        save_result(words.out, result, command)


if __name__ == "__main__":
    main()
