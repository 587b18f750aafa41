"""Learn the contact network from motions that simulated people act out.

Every training clip, and built-in motions of other seeds than any scene's, are simulated and seen by
a rig; detections with a learned detector's errors are drawn from the truth, in every second motion
with lower legs hidden from all views for a second at a time. The network maps features of the
tracks to the simulated contacts: of tracks without contacts, and of the same with those that the
shipped network finds, as the tracker asks it twice. Frames whose true contacts are not known
(`egocap.data.truth.Truth.propped`) are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from tyro.conf import Positional, arg

from egocap.body.labels import LABEL_INDEX
from egocap.commandline import progress
from egocap.data.head_pose import HeadPoses
from egocap.data.truth import SELF_OCCLUDED, VISIBLE
from egocap.detect.synthetic import LEARNED_LIKE
from egocap.errors import EgocapError, InputError
from egocap.evaluation.metrics import f1_score
from egocap.evaluation.table import Table
from egocap.evaluation.world_metrics import touching_feet
from egocap.pose.config import TrackerConfig
from egocap.track.tracker import Tracker
from egocap.world import contact_network
from egocap.world.contact_features import contact_features, sample_times
from egocap.world.contact_network import ContactNetwork, contact_probabilities
from egocap_eval.harness.motion_truth import SimulatedMotion, draw_detections, simulate_scene
from egocap_eval.harness.study import Outcome
from egocap_eval.sets.motion_sets import split_clips
from egocap_sim.scene.config import Scene

BUILT_IN = ("walk", "walk", "stairs", "sit", "dribble", "walk", "stairs", "squat", "gestures")
FIRST_SEED = 330_000
RIGS = ("egorig1", "egorig1", "egorig2")
FRAMES = 240
SHORT, MOST_PEOPLE = 120, 3
"""A clip of fewer frames is acted out by several people."""
HIDDEN_FRAMES = 25  # mean length of a stretch in which a lower leg is hidden
HELD_OUT = 8  # one in so many motions tests the network
SIZES = (32, 24)  # hidden units
EPOCHS, BATCH, RATE, DECAY, DROPOUT, NOISE = 8, 256, 4e-3, 3e-2, 0.3, 0.3


@dataclass(frozen=True, eq=False)
class Example:
    """A motion, tracked before contacts are found and with them, and its true contacts."""

    name: str
    times: Float[Array, "T"]
    tracks: tuple[Float[Array, "T 18 3"], ...]  # joints in the head frame
    sigma: Float[Array, "T 18"]
    heads: HeadPoses
    contact: Bool[Array, "T 4"]
    known: Bool[Array, "T"]  # frames whose contacts are known

    def samples(self) -> tuple[Float[Array, "N F"], Float[Array, "N 2"]]:
        """Features and contacts of heel and toe, of both feet, of all tracks."""
        at = np.searchsorted(self.times, sample_times(self.times) - 1e-6)
        at = np.clip(at, 0, len(self.times) - 1)
        known = self.known[at]
        parts = [
            contact_features(self.times, joints, self.sigma, self.heads.T_world_head)[known]
            for joints in self.tracks
        ]
        features, contact = np.concatenate(parts), np.tile(self.contact[at][known], (len(parts), 1))
        return features.reshape(-1, features.shape[-1]), contact.reshape(-1, 2).astype(float)


def study(
    folder: Positional[Annotated[Path, arg(metavar="DIR")]],
    /,
    write: Annotated[Path, arg(metavar="FILE")] = contact_network.FILE,
    frames: int = FRAMES,
    seed: int = 0,
) -> Outcome:
    """Learn the contact network from the training clips of a folder.

    Args:
        folder: Folder of the motion clips.
        write: File to write; by default the network that the tracker uses.
        frames: Most frames of a motion.
        seed: Seed of the network's first weights.
    """
    if frames < 30:
        raise InputError(f"{frames} frames", valid="30 or more")
    examples = list(_examples(split_clips(folder)["training"], frames))
    held = examples[::HELD_OUT]
    learned = [e for i, e in enumerate(examples) if i % HELD_OUT]
    network = train([e.samples() for e in learned], seed)
    contact_network.save_contact_network(network, write)
    rows = {"learned": learned, "held out": held}
    scores = {name: _score(network, group) for name, group in rows.items()}
    header = ("motions", "number", "frames", "F1 before", "F1 with contacts")
    table = Table("Contact network", header, tuple(
        (n, str(len(g)), str(sum(len(e.times) for e in g)), *(f"{s:.3f}" for s in scores[n]))
        for n, g in rows.items()))  # fmt: skip
    return Outcome({"f1": scores, "motions": [e.name for e in examples]}, [table])


def train(
    samples: list[tuple[Float[Array, "N F"], Float[Array, "N 2"]]], seed: int
) -> ContactNetwork:
    """Fit the network by cross entropy, with noise on the features and dropout."""
    import torch

    features, contact = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    mean, scale = features.mean(0), features.std(0) + 1e-3
    generator = torch.Generator().manual_seed(seed)
    x = torch.tensor((features - mean) / scale, dtype=torch.float32)
    y = torch.tensor(contact, dtype=torch.float32)
    sizes = (x.shape[1], *SIZES, 2)
    weights = [torch.randn(a, b, generator=generator) * (2.0 / a) ** 0.5
               for a, b in pairwise(sizes)]  # fmt: skip
    parameters = [p.requires_grad_() for w in weights for p in (w, torch.zeros(w.shape[1]))]
    steps = EPOCHS * -(-len(x) // BATCH)
    optimiser = torch.optim.AdamW(parameters, lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(x), generator=generator).split(BATCH):
            noise = NOISE * torch.randn(len(batch), x.shape[1], generator=generator)
            logits = _forward(x[batch] + noise, parameters, generator)
            loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, y[batch])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    arrays = [p.detach().numpy().astype(float) for p in parameters]
    return ContactNetwork(mean, scale, *arrays)


def _forward(x: Any, parameters: list[Any], generator: Any) -> Any:
    """Logits, with dropout after the first layer."""
    import torch

    w1, b1, w2, b2, w3, b3 = parameters
    x = torch.relu(x @ w1 + b1)
    kept = torch.rand(x.shape, generator=generator) >= DROPOUT
    x = torch.relu(x * kept / (1.0 - DROPOUT) @ w2 + b2)
    return x @ w3 + b3


def hide_legs(motion: SimulatedMotion, rng: np.random.Generator) -> SimulatedMotion:
    """The motion with lower legs hidden from all views for long stretches, from a joint down."""
    visibility = motion.truth.visibility.copy()
    for side in ("left", "right"):
        leg = [LABEL_INDEX[f"{side}_{part}"] for part in ("knee", "ankle", "foot")]
        first, hidden = 0, bool(rng.random() < 0.5)
        while first < len(visibility):
            last = first + int(rng.exponential(HIDDEN_FRAMES)) + 3
            if hidden:
                part = visibility[first:last, :, leg[int(rng.integers(0, 3)) :]]
                part[part == VISIBLE] = SELF_OCCLUDED
                visibility[first:last, :, leg[-part.shape[2] :]] = part
            first, hidden = last, not hidden
    return replace(motion, truth=replace(motion.truth, visibility=visibility))


def _examples(clips: list[Path], frames: int) -> Iterator[Example]:
    """Tracks of clips and built-in motions; a motion that cannot be simulated is left out."""
    jobs: list[tuple[str, dict[str, Any]]] = [(m, {"name": m}) for m in BUILT_IN]
    jobs += [(path.stem, {"file": str(path.resolve())}) for path in clips]
    made = 0
    with progress("motions", len(jobs), unit="motions") as advance:
        for name, motion in jobs:
            for person in range(MOST_PEOPLE):
                try:
                    example = _example(name, motion, frames, made)
                except EgocapError:
                    break
                made += 1
                yield example
                if len(example.times) * (person + 1) >= SHORT:
                    break
            advance(1)


def _example(name: str, motion: dict[str, Any], frames: int, index: int) -> Example:
    seed = FIRST_SEED + index
    scene = Scene.model_validate({
        "name": name, "frames": frames, "seed": seed, "motion": motion,
        "rig": {"name": RIGS[index % len(RIGS)], "size": (640, 512)},
        "place": {"name": "room", "clear_radius": 2.5},
    })  # fmt: skip
    if "file" in motion:
        from egocap_sim.world.world import World

        scene = scene.model_copy(update={"frames": min(frames, World(scene).clip_frames)})
    simulated = simulate_scene(scene)
    if index % 2:
        simulated = hide_legs(simulated, np.random.default_rng([seed, 2]))
    found, truth = draw_detections(simulated, LEARNED_LIKE, seed), simulated.truth
    heads = HeadPoses(truth.T_world_head, np.ones(len(truth.time), bool))
    before, after = (
        Tracker(simulated.rig, simulated.proportions, TrackerConfig(contacts=contacts)).track(
            found, heads=heads
        )
        for contacts in (False, True)
    )
    assert before.covariance is not None
    sigma = np.sqrt(np.trace(before.covariance, axis1=2, axis2=3) / 3.0)
    tracks = (before.joints_head, after.joints_head)
    return Example(name, truth.time, tracks, sigma, heads, truth.contact, ~truth.propped)


def _score(network: ContactNetwork, examples: list[Example]) -> list[float]:
    """F1 of planted feet over all known frames, of each kind of track."""
    true = np.concatenate([touching_feet(e.contact)[e.known] for e in examples])
    scores = []
    for kind in range(len(examples[0].tracks)):
        found = [
            contact_probabilities(e.times, e.tracks[kind], e.sigma, e.heads, network)[e.known]
            for e in examples
        ]
        scores.append(f1_score(touching_feet(np.concatenate(found) >= 0.5), true))
    return scores
