"""Training of the motion network: tracks with errors in, weights out.

The networks learn to correct a track's angles: the mean by the distance of the joints that it
leaves, to first order, and the standard deviations by the likelihood of a Student-t. Head poses are
left out of half of the examples, and interrupted in some. Each network is trained without a group
of subjects, so that they disagree about motions unlike those learned.

Source: Loshchilov & Hutter 2019 (AdamW); Smith & Topin 2018 (one-cycle learning rates).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from numpy import ndarray as Array
from torch import Tensor, nn

from egocap.body.labels import EVALUATED
from egocap.body.skeleton import DOF_COUNT, jacobian
from egocap.commandline import progress
from egocap.pose.motion_features import GROUPS, POSE_COUNT
from egocap.pose.motion_network import (
    DILATIONS,
    INPUTS,
    MOST_LOG_STD,
    STEP_S,
    UNIT,
    MotionNetwork,
    network_inputs,
)
from egocap.series import interpolate
from egocap_eval.priors.config import TrainingConfig
from egocap_eval.priors.tracks import LearningTrack, both_ways

_DEGREES = 5  # of the Student-t
_POSITION_WEIGHT = 30.0  # per metre
_KNOWN, _GAP = (0.3, 0.15, 0.15, 0.4), 0.1
"""Fractions of examples with none of the head's features to all groups of them; with a gap."""
_SHRINK = 0.1
"""Weight of independence in the correlation of the angles' errors."""
_WARP = 0.12  # of a take's speed, either way
_BUILT_IN_WEIGHT, _LONGEST = 0.2, 200  # of takes as examples; steps beyond which longer is no more


@dataclass(frozen=True, eq=False)
class Example:
    """A track at the network's steps."""

    inputs: Float[Array, "N 152"]
    correction: Float[Array, "N 37"]  # to the truth, rad
    jacobian: Float[Array, "N 54 37"]  # of the true joints, m per rad
    weight: float


class Network(nn.Module):
    """One member, as `MotionNetwork` evaluates it."""

    def __init__(self, channels: int, dropout: float) -> None:
        super().__init__()
        self.into = nn.Conv1d(INPUTS, channels, 1)
        self.blocks = nn.ModuleList(
            nn.Conv1d(channels, channels, 3, dilation=d, padding=d) for d in DILATIONS
        )
        self.out = nn.Conv1d(channels, 2 * DOF_COUNT, 1)
        nn.init.zeros_(self.out.weight)
        assert self.out.bias is not None
        nn.init.zeros_(self.out.bias)
        self.dropout = nn.Dropout(dropout)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Inputs (B, 152, N) to corrections (B, 37, N) in `UNIT` and logs of their deviations."""
        hidden = self.into(inputs)
        for block in self.blocks:
            hidden = hidden + block(self.dropout(F.silu(hidden)))
        mean, log_std = self.out(F.silu(hidden)).chunk(2, dim=1)
        return mean, log_std.clamp(-MOST_LOG_STD, MOST_LOG_STD)


def train_network(
    tracks: Sequence[LearningTrack], config: TrainingConfig, seed: int = 0
) -> MotionNetwork:
    """Train the members on tracks and their mirror images, each without a group of subjects."""
    rng = np.random.default_rng(seed)
    examples = [make_example(t, rng.uniform(1 - _WARP, 1 + _WARP)) for t in both_ways(tracks)]
    group = np.repeat(subject_groups([t.name for t in tracks], config.members), 2)
    members = []
    with progress("training", config.members * config.steps, unit="steps") as advance:
        for member in range(config.members):
            torch.manual_seed(seed + member)
            network = Network(config.channels, config.dropout)
            of_others = [e for e, g in zip(examples, group, strict=True) if g != member]
            for loss in _fit(network, of_others or examples, config, rng):
                assert np.isfinite(loss)
                advance()
            members.append(network.eval())
    return export(members, examples)


def subject_groups(names: Sequence[str], count: int) -> list[int]:
    """A group of each take, 0 to `count` - 1: takes of a subject together, groups of like size.

    Takes of a name that differs in its last number alone are of a subject; built-in motions are of
    one.
    """
    subjects = ["builtin" if n.startswith("builtin") else re.sub(r"_?\d+$", "", n) for n in names]
    sizes, group = [0] * count, {}
    for subject, size in Counter(subjects).most_common():
        group[subject] = sizes.index(min(sizes))
        sizes[group[subject]] += size
    return [group[subject] for subject in subjects]


def make_example(track: LearningTrack, speed: float = 1.0) -> Example:
    """A track, at another speed, at the network's steps."""
    times = track.times * speed
    steps = np.arange(0.0, times[-1] + 1e-9, STEP_S)
    inputs = network_inputs(times, track.angles, track.std, track.person, track.heads)
    tracked, truth = (interpolate(steps, times, a) for a in (track.angles, track.truth))
    _, J = jacobian(track.person, truth)
    weight = np.sqrt(min(len(steps), _LONGEST))
    weight *= _BUILT_IN_WEIGHT if track.name.startswith("builtin") else 1.0
    return Example(
        interpolate(steps, times, inputs).astype(np.float32), (truth - tracked).astype(np.float32),
        J.reshape(len(steps), -1, DOF_COUNT).astype(np.float32), float(weight),
    )  # fmt: skip


def _fit(
    network: Network, examples: Sequence[Example], config: TrainingConfig, rng: np.random.Generator
) -> Iterator[float]:
    """Train one member; yields the loss of every step."""
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.learning_rate, total_steps=config.steps, pct_start=0.1
    )
    weights = np.array([example.weight for example in examples])
    for _ in range(config.steps):
        chosen = rng.choice(len(examples), size=config.batch, p=weights / weights.sum())
        loss = _loss(network, *_batch([examples[i] for i in chosen], config, rng))
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        yield loss.item()


def _batch(
    examples: Sequence[Example], config: TrainingConfig, rng: np.random.Generator
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Inputs (B, 152, N), corrections (B, 37, N), Jacobians (B, N, 54, 37), valid steps (B, N)."""
    rows = []
    for example in examples:
        count = len(example.inputs)
        first = rng.integers(max(count - config.length, 0) + 1)
        at = np.minimum(first + np.arange(config.length), count - 1)
        valid = first + np.arange(config.length) < count
        inputs = _varied(example.inputs[at], config.noise, rng)
        rows.append((inputs.T, example.correction[at].T, example.jacobian[at], valid))
    inputs, correction, J, valid = (
        torch.from_numpy(np.stack(part).astype(np.float32)) for part in zip(*rows, strict=True)
    )
    return inputs, correction, J, valid


def _varied(
    inputs: Float[Array, "N 152"], noise: float, rng: np.random.Generator
) -> Float[Array, "N 152"]:
    """Inputs with noise, and with the head pose that a user may have."""
    head = inputs.shape[1] - len(GROUPS)
    varied = inputs.copy()
    varied[:, :head] += noise * rng.standard_normal((1, head))
    varied[:, :POSE_COUNT] += noise * rng.standard_normal((len(inputs), POSE_COUNT))
    known = np.zeros((len(inputs), len(GROUPS)))
    known[:, : rng.choice(len(_KNOWN), p=_KNOWN)] = 1.0
    if rng.random() < _GAP:
        first = rng.integers(len(inputs))
        known[first : first + rng.integers(3, 15)] = 0.0
    for group, there in zip(GROUPS, known.T, strict=True):
        varied[:, POSE_COUNT:head][:, group] *= there[:, None]
    varied[:, head:] = known
    return varied


def _loss(network: Network, inputs: Tensor, correction: Tensor, J: Tensor, valid: Tensor) -> Tensor:
    mean, log_std = network(inputs)
    error = UNIT * mean - correction
    squared = (error / (UNIT * log_std.exp())).square()
    likelihood = 0.5 * (_DEGREES + 1) * torch.log1p(squared / _DEGREES) + log_std
    moved = torch.einsum("bnxd,bdn->bnx", J, error).unflatten(-1, (-1, 3))
    distance = moved[..., list(EVALUATED), :].norm(dim=-1).mean(-1)
    loss = likelihood.mean(1) + _POSITION_WEIGHT * distance
    return (loss * valid).sum() / valid.sum()


def export(members: Sequence[Network], examples: Sequence[Example]) -> MotionNetwork:
    """The members' weights, and the correlation of their errors on the examples."""

    def stacked(name: str) -> Float[Array, "M *any"]:
        return np.stack([m.state_dict()[name].numpy() for m in members])

    blocks = range(len(DILATIONS))
    network = MotionNetwork(
        into=stacked("into.weight")[..., 0].swapaxes(1, 2), into_bias=stacked("into.bias"),
        blocks=np.stack([stacked(f"blocks.{b}.weight").transpose(0, 3, 2, 1) for b in blocks], 1),
        block_biases=np.stack([stacked(f"blocks.{b}.bias") for b in blocks], 1),
        out=stacked("out.weight")[..., 0].swapaxes(1, 2), out_bias=stacked("out.bias"),
        correlation=np.eye(DOF_COUNT, dtype=np.float32),
    )  # fmt: skip
    return replace(network, correlation=_correlation(network, examples))


def _correlation(network: MotionNetwork, examples: Sequence[Example]) -> Float[Array, "37 37"]:
    """Correlation of the angles' errors, shrunk towards independence."""
    errors = []
    for example in examples:
        mean, std = network(example.inputs)
        errors.append((mean - example.correction) / std)
    found = np.corrcoef(np.concatenate(errors).T)
    return ((1.0 - _SHRINK) * found + _SHRINK * np.eye(DOF_COUNT)).astype(np.float32)
