"""Time the volumetric image model and its torch reference on the same rays.

    python benchmarks/image_model.py SEQ                     # a simulated sequence
    python benchmarks/image_model.py SEQ --out FILE.json     # and write the numbers
    python benchmarks/image_model.py SEQ --device cuda       # and many poses at once, on a GPU

SEQ is the first live sequence that `egocap-eval refresh image_model` makes. The pose is the one
nearest to the truth of frame 0, the image that frame's. Colours are compared in three ways:
`ratio`, the likelihood ratio of person and background (`image_model.palette`), which the tracker
uses; `paper`, appendix A; `cone`, the distance in the HSV cone.

`ms` is the smallest wall time of many calls, `median_ms` the median; `cpu_ms` is the mean processor
time of all threads, which depends less on other load. The reference is
`image_model.torch_energy` with autograd, single precision, on the rays that meet the body only: on
all rays it would take several times longer.
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
STOCHASTIC_RAYS, KEEP = 600, 0.5
DRAWS = 200
MEASURES = ("ratio", "paper", "cone")
FIRST_CALL = """
import time, numpy as np
started = time.perf_counter()
from egocap.body.proportions import Proportions
from egocap.body.gaussians import GaussianBody
from egocap.cameras.rig_files import load_rig
from egocap.image_model.model import ImageModel
from egocap.image_model.image_rays import image_rays
imported = time.perf_counter()
body = GaussianBody.from_proportions(Proportions.from_lengths())
rays = image_rays(load_rig("scenes/rigs/egorig1.toml"), 32, 32)
ImageModel(body, rays).evaluate(np.zeros(37), np.zeros((len(rays), 3), np.float32), curvature=True)
print(imported - started, time.perf_counter() - imported)
"""


def best(call: Callable[[], Any], repeats: int = 60) -> dict[str, float]:
    """Smallest and median wall time, and mean processor time, of a call in milliseconds."""
    call()
    walls, busy = [], time.process_time()
    for _ in range(repeats):
        wall = time.perf_counter()
        call()
        walls.append(time.perf_counter() - wall)
    busy = time.process_time() - busy
    return {
        "ms": round(1e3 * min(walls), 4),
        "median_ms": round(1e3 * float(np.median(walls)), 4),
        "cpu_ms": round(1e3 * busy / repeats, 4),
    }


class Bench:
    """A coloured body and a frame of a sequence."""

    def __init__(self, folder: str) -> None:
        from egocap.body.gaussians import GaussianBody
        from egocap.data.sequence import Sequence
        from egocap.image_model.image_rays import image_rays
        from egocap.image_model.palette import colour_body, learn_palette
        from egocap.pose.inverse_kinematics import nearest_angles

        self.sequence = sequence = Sequence(folder)
        truth = sequence.truth.joints_head
        self.angles = nearest_angles(sequence.body, truth[0])
        self.images = sequence.frame(0).images
        rays = image_rays(sequence.rig, *SIZE)
        plain = GaussianBody.from_proportions(sequence.body)
        self.body = colour_body(plain, rays, self.images, self.angles)
        shown = []
        for t in np.linspace(0, len(sequence) - 1, 5).round().astype(int):
            angles = nearest_angles(sequence.body, truth[t])
            shown.append((sequence.frame(int(t)).images, angles))
        self.palette = learn_palette(self.body, rays, shown)

    def term(self, size: int = SIZE[0], threads: int | None = None):
        """The body's colours against the background's."""
        from egocap.image_model.colour_term import ColourTerm, ColourTermConfig

        config = ColourTermConfig(size, weight=0.03)
        return ColourTerm(self.body, self.sequence.rig, self.palette, config, threads)

    def model(self, measure: str, threads: int | None = None):
        """A model and the measure's features of the frame along its rays."""
        from egocap.image_model.colour_measure import PAPER, ColourMeasure
        from egocap.image_model.image_rays import image_rays
        from egocap.image_model.model import ImageModel

        if measure == "ratio":
            term = self.term(threads=threads)
            return term.model, term.set_images(self.images, self.angles)
        kind = PAPER if measure == "paper" else ColourMeasure()
        rays = image_rays(self.sequence.rig, *SIZE)
        model = ImageModel(self.body, rays, measure=kind, threads=threads)
        return model, model.colours(self.images)

    def kernel(self, measure: str) -> dict[str, Any]:
        """The compiled model."""
        model, colours = self.model(measure)
        alone, _ = self.model(measure, threads=1)
        met = int((model.pixel_energies(self.angles, colours)[0] != 0).sum())
        return {
            "rays": len(model.rays), "rays_that_meet_the_body": met,
            "energy_and_gradient": best(lambda: model.evaluate(self.angles, colours)),
            "one_thread": best(lambda: alone.evaluate(self.angles, colours)),
            "with_gauss_newton": best(
                lambda: model.evaluate(self.angles, colours, curvature=True)
            ),
        }  # fmt: skip

    def frame(self) -> dict[str, float]:
        """What a new frame costs before the first step: its bins, and the background's colours."""
        term = self.term()
        term.set_images(self.images, self.angles)
        return best(lambda: term.set_images(self.images))

    def stochastic(self) -> dict[str, Any]:
        """One step of the stochastic variant, and the scatter of its gradient."""
        from egocap.image_model.stochastic import PixelSampler, gradient_scatter

        model, colours = self.model("ratio")
        alone, _ = self.model("ratio", threads=1)
        rng = np.random.default_rng(0)
        aimed, evenly, single = PixelSampler(model), PixelSampler(model), PixelSampler(alone)
        for sampler in (aimed, single):
            sampler.aim(colours, self.angles)

        def step(sampler: PixelSampler) -> None:
            sampler.estimate(colours, self.angles, STOCHASTIC_RAYS, KEEP, rng)

        def scatter(sampler: PixelSampler) -> float:
            draw = (colours, self.angles, STOCHASTIC_RAYS, KEEP, DRAWS)
            return round(gradient_scatter(sampler, *draw, np.random.default_rng(0)), 4)

        return {
            "rays": STOCHASTIC_RAYS, "keep": KEEP,
            "step": best(lambda: step(aimed), 300), "one_thread": best(lambda: step(single), 300),
            "gradient_scatter": scatter(aimed), "gradient_scatter_even": scatter(evenly),
        }  # fmt: skip

    def reference(self, measure: str, kernel_ms: float) -> dict[str, Any]:
        """The torch reference on the rays that meet the body."""
        import torch

        from egocap.image_model.torch_energy import ReferenceModel, colour_gradient

        model, colours = self.model(measure)
        reference = ReferenceModel(self.body, model.rays, model.measure, torch.float32)
        batch, compare = reference.batch(colours)
        hit = torch.as_tensor(np.flatnonzero(model.pixel_energies(self.angles, colours)[0]))
        batch, angles = batch[hit], torch.as_tensor(self.angles, dtype=torch.float32)
        times = best(lambda: colour_gradient(self.body, batch, angles, compare), 2)
        return {**times, "times_slower": round(times["ms"] / kernel_ms, 1)}

    def live(self) -> dict[str, Any]:
        """Colour-only tracking of the upper body over the sequence, images in memory."""
        from egocap.body.labels import UPPER
        from egocap.track.colour_tracker import TERM, ColourTracker

        frames = list(self.sequence)
        truth = self.sequence.truth.joints_head
        rates, busy, poses = [], [], []
        for _ in range(3):
            tracker = ColourTracker(self.sequence.rig, self.sequence.body, self.angles)
            tracker.learn(frames[0].images)
            started, spent = time.perf_counter(), time.process_time()
            poses = [p for frame in frames for p in tracker.step(frame.images, frame.time)]
            rates.append(len(frames) / (time.perf_counter() - started))
            busy.append(1e3 * (time.process_time() - spent) / len(frames))
        errors = np.linalg.norm(np.array([p.joints_head for p in poses]) - truth, axis=-1)
        return {
            "size": TERM.size,
            "frames_per_second": round(max(rates), 1),
            "cpu_ms_a_frame": round(min(busy), 3),
            "upper_body_error_mm": round(float(1e3 * errors[:, UPPER].mean()), 1),
        }

    def batched(self, device: str, poses: int, chunk: int) -> dict[str, Any]:
        """Many poses at once by the torch path, energy and gradient; `chunk` rays at a time."""
        import torch

        from egocap.image_model.torch_energy import ReferenceModel, colour_gradient

        model, colours = self.model("ratio")
        reference = ReferenceModel(self.body, model.rays, dtype=torch.float32, device=device)
        batch, compare = reference.batch(colours)
        angles = torch.as_tensor(np.tile(self.angles, (poses, 1)), dtype=torch.float32).to(device)

        def call() -> None:
            colour_gradient(self.body, batch, angles, compare, chunk=chunk)
            if batch.device.type == "cuda":
                torch.cuda.synchronize(batch.device)

        times = best(call, 3)
        energy = colour_gradient(self.body, batch, angles[:1], compare, chunk=chunk)[0].item()
        exact = model.evaluate(self.angles, colours).energy
        name = torch.cuda.get_device_name(batch.device) if batch.device.type == "cuda" else "cpu"
        return {
            "device": name, "poses": poses, "rays_at_a_time": chunk, **times,
            "ms_a_pose": round(times["ms"] / poses, 4), "energy": energy, "energy_by_kernel": exact,
        }  # fmt: skip


def first_call() -> dict[str, float]:
    """Seconds to import, and to the first result without and with cached kernels."""
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


def measured(words: argparse.Namespace) -> dict[str, Any]:
    """All times. Raises MachineError first when the requested device is missing."""
    if words.device:
        from egocap.image_model.torch_energy import torch_device

        torch_device(words.device)
    bench = Bench(words.sequence)
    kernel = {measure: bench.kernel(measure) for measure in MEASURES}
    result = {
        "kernel": kernel,
        "a_frame": bench.frame(),
        "stochastic": bench.stochastic(),
        "reference": {
            measure: bench.reference(measure, kernel[measure]["energy_and_gradient"]["ms"])
            for measure in ("ratio", "paper")
        },
        "live": bench.live(),
        "start": first_call(),
    }
    if words.device:
        result["batched"] = bench.batched(words.device, words.poses, words.chunk)
    return result


def main() -> int:
    """Measure, print, and write when asked; the exit code."""
    from egocap.errors import EgocapError

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sequence")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--device", help="also many poses at once on cpu, cuda or cuda:N")
    parser.add_argument("--poses", type=int, default=16, help="at once on the device")
    parser.add_argument("--chunk", type=int, default=128, help="rays at a time on the device")
    words = parser.parse_args()
    try:
        result = measured(words)
    except EgocapError as error:
        print(f"image_model: {error}", file=sys.stderr)
        return error.exit_code
    print(json.dumps(result, indent=2))
    if words.out:
        from egocap_eval.harness.result_file import save_result

        result["load"] = list(os.getloadavg())
        name = Path(words.sequence).name
        save_result(words.out, result, f"python benchmarks/image_model.py {name} --out {words.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
