"""Tracking as the paper does: one frame after another by `paper_solver`, then a low-pass.

The person's colours are read off the frame whose pose is surest, and the first pose is taken from
there, too: both come from the default solver over the first frames, in place of the paper's
personalisation from a few poses. That time is kept apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.image_model.colour_measure import PAPER
from egocap.image_model.image_rays import image_rays, require_pictures
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import colour_body
from egocap.paper.config import PAPER_SOLVERS, PaperConfig
from egocap.paper.solver import Frame, PaperSolver
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import predict
from egocap.pose.kernel import make_model
from egocap.pose.observations import observe
from egocap.track.colour_refinement import surest_frames
from egocap.track.joint_occlusion import why_hidden
from egocap.track.smoother import smooth_gaussian
from egocap.track.uncertainty import causal_covariances

Images = Callable[[int], Sequence[UInt8[Array, "H W 3"]]]
"""RGB images of all views at a frame."""
LOOKED_AT = 60
"""Frames from the beginning among which one is sought that shows the person's colours."""


def track_as_paper(
    detections: Detections, rig: Rig, proportions: Proportions, images: Images,
    config: PaperConfig = PAPER_SOLVERS["reference"], low_pass: float = 1.0, seed: int = 0,
) -> Track:  # fmt: skip
    """Track a person by equation 1 with the paper's weights.

    `low_pass` is the standard deviation in frames of the filter over 5 frames (section 5.5); 0
    leaves it out. `seed` is of the random pixels. `energies` are those before the filter. The time
    is that of preparing and solving frames on the threads that numba has; `config["seconds"]` has
    it by stage, beside that of reading images, finding colours, and working out the energies.
    Raises InputError for pictures of another aspect than the rig's.
    """
    times, views = np.asarray(detections.times, float), len(rig.mounts)
    plain = TrackerConfig()
    seen = observe(detections, rig, proportions, plain)
    there = seen.weights > 0.0
    confidence = np.where(there, np.nan_to_num(detections.confidence), 0.0)
    seconds: dict[str, float] = {}
    require_pictures(rig, images(0))
    started = time.perf_counter()
    body, start = _personalised(detections, rig, proportions, images)
    seconds["personalise"] = time.perf_counter() - started
    image = ImageModel(body, image_rays(rig, *config.size), measure=PAPER)
    solver = PaperSolver(image, make_model(proportions, plain), config)
    rng = np.random.default_rng(seed)
    angles, energies = np.zeros((len(times), len(start))), np.zeros((len(times), 4))
    converged, last, before = np.zeros(len(times), bool), start, start
    _warm(solver, image, start, views)
    for t in range(len(times)):
        clock = [time.perf_counter()]
        pictures = images(t)
        clock.append(time.perf_counter())
        predicted = predict(last, before, config.zeta)
        colours = image.colours(pictures)
        frame = Frame(colours, seen.centres, seen.rays[t], confidence[t], predicted)
        found = solver.solve(frame, predicted, rng)
        clock.append(time.perf_counter())
        energies[t] = solver.terms(frame, found.angles)
        clock.append(time.perf_counter())
        for stage, spent in zip(("images", "frames", "energies"), np.diff(clock), strict=True):
            seconds[stage] = seconds.get(stage, 0.0) + float(spent)
        angles[t], converged[t] = found.angles, found.converged
        last, before = found.angles, last
    if low_pass > 0.0:
        angles = smooth_gaussian(angles, low_pass)
    return Track(
        times=times, angles=angles, joints_head=forward(proportions, angles),
        energy=energies.sum(1), converged=converged,
        detections_used=there.sum((1, 2)).astype(float),
        seconds_per_frame=seconds["frames"] / len(times),
        config={"paper": asdict(config), "detections": detections.source, "rig": rig.name,
                "seconds": seconds},
        offsets=np.array(proportions.offsets), energies=energies,
        hidden=why_hidden(angles, detections, rig, proportions),
    )  # fmt: skip


def _personalised(
    detections: Detections, rig: Rig, proportions: Proportions, images: Images
) -> tuple[GaussianBody, Float[Array, "37"]]:
    """The person's colours from the surest early frame, and the first frame's pose."""
    from egocap.track.online_filter import follow

    config = TrackerConfig(smoothing="none")
    seen = observe(detections, rig, proportions, config)[:LOOKED_AT]
    model = make_model(proportions, config)
    angles, _, taken = follow(seen, model, config)
    (surest,) = surest_frames(causal_covariances(angles, taken, model, config), 1)
    body = GaussianBody.from_proportions(proportions)
    rays = image_rays(rig, 128, 128)
    return colour_body(body, rays, images(surest), angles[surest]), angles[0]


def _warm(solver: PaperSolver, image: ImageModel, start: Float[Array, "37"], views: int) -> None:
    """Compile the kernels, or load them from the cache, outside the clock."""
    blank = Frame(
        np.zeros((len(image.rays), 3), np.float32), np.zeros((views, 3)),
        np.ones((views, 18, 3)), np.zeros((views, 18)), start,
    )  # fmt: skip
    short = PaperSolver(image, solver.skeleton, replace(solver.config, iterations=1))
    short.solve(blank, start, np.random.default_rng(0))
    short.terms(blank, start)


def refuse_unused(config: TrackerConfig) -> None:
    """Raise InputError for settings that the paper's solvers do not have, if they were changed."""
    plain = TrackerConfig()
    used = {"solver", "smoothing", "gaussian_frames"}
    for name, value in asdict(config).items():
        if name not in used and value != getattr(plain, name):
            raise InputError(
                f"{name} = {value} with solver '{config.solver}'",
                valid="the solver 'fast', or leave it at its default",
            )
