"""Settings of the training of the motion network."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrainingConfig:
    """How the networks are trained."""

    members: int = 5
    """Networks that are averaged, each trained without a share of the subjects."""
    channels: int = 96
    """Channels of each."""
    steps: int = 700
    """Training steps of each."""
    batch: int = 48
    """Examples a step."""
    length: int = 45
    """Length of an example in steps of the network."""
    learning_rate: float = 2e-3
    """Maximum learning rate."""
    weight_decay: float = 0.05
    """Weight decay."""
    dropout: float = 0.3
    """Fraction of channels dropped."""
    noise: float = 0.15
    """Standard deviation of noise on the inputs."""
