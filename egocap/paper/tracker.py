"""Tracking with the paper's solvers: frame after frame, then a low-pass.

The person's colours and the first pose come from the default solver over the first frames, in place
of the paper's personalisation from a few poses. That time is kept apart.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.body.gaussians import GaussianBody
from egocap.body.proportions import Proportions
from egocap.body.skeleton import forward
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.data.head_pose import HeadPoses, in_world
from egocap.data.track import Track
from egocap.errors import InputError
from egocap.image_model.colour_measure import PAPER
from egocap.image_model.image_rays import image_rays, require_pictures
from egocap.image_model.model import ImageModel
from egocap.image_model.palette import colour_body
from egocap.paper.config import PAPER_SOLVERS, PaperConfig, PaperSolverName, SolverName
from egocap.paper.solver import Frame, PaperSolver
from egocap.pose.config import TrackerConfig
from egocap.pose.energy import predict
from egocap.pose.kernel import make_model
from egocap.pose.observations import Observations, observe
from egocap.track.colour_refinement import Images, most_certain_frames
from egocap.track.consistency import with_consistency
from egocap.track.joint_occlusion import occlusion_causes
from egocap.track.online_filter import filter_sequence
from egocap.track.smoother import smooth_gaussian
from egocap.track.stopwatch import OnFrames, Stopwatch
from egocap.track.tracker import Tracker, require_increasing_times
from egocap.track.uncertainty import causal_covariances

_CAUSAL = TrackerConfig(smoothing="none")
PERSONALISATION_FRAMES = 60
"""First frames of which the most certain one gives the person's colours."""


def make_tracker(
    rig: Rig, proportions: Proportions, solver: SolverName = "fast",
    config: TrackerConfig = TrackerConfig(),  # noqa: B008 (frozen)
) -> Tracker | PaperTracker:  # fmt: skip
    """The tracker with a solver of that name.

    Of the settings, the paper's solvers have the smoothing alone: its low-pass, or none. Raises
    InputError for an unknown solver, and for other settings that were changed.
    """
    if solver == "fast":
        return Tracker(rig, proportions, config)
    default = TrackerConfig()
    for name, value in asdict(config).items():
        own = name in ("smoothing", "gaussian_sigma_frames") and value != "fixed-lag"
        if not own and value != getattr(default, name):
            raise InputError(
                f"{name} = {value} with solver '{solver}'",
                valid="the solver 'fast', or leave it at its default",
            )
    low_pass = 0.0 if config.smoothing == "none" else config.gaussian_sigma_frames
    return PaperTracker(rig, proportions, solver, low_pass=low_pass)


class PaperTracker:
    """Tracks a person by equation 1 with the paper's weights.

    `solver` is 'reference', 'stochastic', or their settings. `low_pass` is the standard deviation
    in frames of the filter over 5 frames (section 5.5); 0 leaves it out. `seed` is of the random
    pixels. Raises InputError for another name.
    """

    def __init__(
        self, rig: Rig, proportions: Proportions,
        solver: PaperSolverName | PaperConfig = "reference", *,
        low_pass: float = 1.0, seed: int = 0,
    ) -> None:  # fmt: skip
        self.rig, self.proportions, self.low_pass, self.seed = rig, proportions, low_pass, seed
        if isinstance(solver, PaperConfig):
            self.config, self._name = solver, "custom"
        elif solver in PAPER_SOLVERS:
            self.config, self._name = PAPER_SOLVERS[solver], solver
        else:
            raise InputError(f"solver '{solver}'", valid=("fast", *PAPER_SOLVERS))

    def track(
        self, detections: Detections, images: Images | None = None, heads: HeadPoses | None = None,
        on_frames: OnFrames = lambda count: None,
    ) -> Track:  # fmt: skip
        """Track from detections and images of all views.

        With `heads`, the head poses of the frames, the track is moved into the world, too. `images`
        gives the RGB images of all views at a frame. `Track.energies` are those before the
        low-pass. The time per frame is that of preparing and solving frames on numba's threads;
        `config["seconds"]` has it by stage, besides that of reading images, personalisation and
        energies. `on_frames` is called with 1 after every frame. Raises InputError as
        `Tracker.track`, without images, and for images of another aspect than the rig's.
        """
        require_increasing_times(detections)
        if images is None:
            raise InputError("the paper's solvers without images", valid="images of every frame")
        seen = observe(detections, self.rig, self.proportions, TrackerConfig())
        valid = seen.weights > 0.0
        require_pictures(self.rig, images(0))
        stopwatch = Stopwatch()
        body, start = self._personalise(detections, images)
        stopwatch.lap("personalise")
        image = ImageModel(body, image_rays(self.rig, *self.config.size), measure=PAPER)
        model = make_model(self.proportions, TrackerConfig())
        solver = PaperSolver(image, model, self.config)
        warm_up_s = _warm_up(solver, start, len(seen.centres))
        confidence = np.where(valid, np.nan_to_num(detections.confidence), 0.0)
        angles, converged, energies = self._solve(
            solver, seen, confidence, images, start, stopwatch, on_frames
        )
        if self.low_pass > 0.0:
            angles = smooth_gaussian(angles, self.low_pass)
        track = Track(
            times=seen.times, angles=angles, joints_head=forward(self.proportions, angles),
            energy=energies.sum(1), converged=converged,
            detections_used=valid.sum((1, 2)).astype(float),
            seconds_per_frame=stopwatch.seconds["frames"] / len(angles),
            config={
                "solver": self._name, "paper": asdict(self.config), "low_pass": self.low_pass,
                "seed": self.seed, "detections": detections.source, "rig": self.rig.name,
                "seconds": stopwatch.seconds, "warm_up_s": round(warm_up_s, 3),
            },
            offsets=np.array(self.proportions.offsets), energies=energies,
            hidden=occlusion_causes(angles, detections, self.rig, self.proportions),
        )  # fmt: skip
        track = with_consistency(track, detections, self.rig, self.proportions)
        return track if heads is None else in_world(track, heads)

    def _solve(
        self, solver: PaperSolver, seen: Observations, confidence: Float[Array, "T V 18"],
        images: Images, start: Float[Array, "37"], stopwatch: Stopwatch, on_frames: OnFrames,
    ) -> tuple[Float[Array, "T 37"], Bool[Array, "T"], Float[Array, "T 4"]]:  # fmt: skip
        """Angles, convergence and energies of one frame after another."""
        frames, rng = len(seen.times), np.random.default_rng(self.seed)
        angles, energies = np.zeros((frames, len(start))), np.zeros((frames, 4))
        converged, last, before = np.zeros(frames, bool), start, start
        stopwatch.skip()
        for t in range(frames):
            pictures = images(t)
            stopwatch.lap("images")
            predicted = predict(last, before, self.config.zeta)
            colours = solver.image.colours(pictures)
            frame = Frame(colours, seen.centres, seen.rays[t], confidence[t], predicted)
            found = solver.solve(frame, predicted, rng)
            stopwatch.lap("frames")
            energies[t] = solver.terms(frame, found.angles)
            stopwatch.lap("energies")
            angles[t], converged[t] = found.angles, found.converged
            last, before = found.angles, last
            on_frames(1)
        return angles, converged, energies

    def _personalise(
        self, detections: Detections, images: Images
    ) -> tuple[GaussianBody, Float[Array, "37"]]:
        """The body with colours of the most certain early frame, and the first frame's pose."""
        observations = observe(detections, self.rig, self.proportions, _CAUSAL)
        model = make_model(self.proportions, _CAUSAL)
        angles, _, chosen = filter_sequence(observations[:PERSONALISATION_FRAMES], model, _CAUSAL)
        covariances = causal_covariances(angles, chosen, model, _CAUSAL)
        (certain,) = most_certain_frames(covariances, 1)
        body = GaussianBody.from_proportions(self.proportions)
        rays = image_rays(self.rig, 128, 128)
        return colour_body(body, rays, images(certain), angles[certain]), angles[0]


def _warm_up(solver: PaperSolver, start: Float[Array, "37"], views: int) -> float:
    """Compile the kernels, or load them from numba's cache; the seconds that took."""
    started = time.perf_counter()
    blank = Frame(
        np.zeros((len(solver.image.rays), 3), np.float32), np.zeros((views, 3)),
        np.ones((views, 18, 3)), np.zeros((views, 18)), start,
    )  # fmt: skip
    short = PaperSolver(solver.image, solver.skeleton, replace(solver.config, iterations=1))
    short.solve(blank, start, np.random.default_rng(0))
    short.terms(blank, start)
    return time.perf_counter() - started
