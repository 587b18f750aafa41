"""Settings of a training run; field comments are the command line's help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from egocap.errors import InputError


@dataclass(frozen=True)
class AugmentationConfig:
    """How training images are changed. Chances are per image."""

    background: float = 0.25  # chance that everything but the wearer comes from another image
    recolour: float = 0.5  # chance that clothes and skin change colour, shading kept
    camouflage: float = 0.15  # chance that a garment has about the colour of what is behind it
    scale: float = 0.15  # largest relative change of size
    rotation_deg: float = 8.0  # largest rotation: how much rigs are askew
    shift: float = 0.04  # largest shift, of the image's width
    gamma: float = 2.0  # gamma lies between its inverse and this
    colour: float = 0.5  # chance of another colour temperature, saturation and contrast
    blur: float = 0.3  # chance of blur, half of it by motion
    noise: float = 0.5  # chance of sensor noise
    jpeg: float = 0.2  # chance of another round of JPEG
    occluders: float = 0.2  # chance of things in front


NO_AUGMENTATION = AugmentationConfig(0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0)
"""Leaves images as they are."""


@dataclass(frozen=True)
class LossConfig:
    """Weights of the terms, and how wide targets are."""

    seen_cells: float = 0.75  # standard deviation of the target of a visible label
    hidden_cells: float = 1.25  # and of one in view but occluded
    hidden: float = 0.5  # weight of occluded labels
    extremities: float = 1.5  # weight of wrists, hands, knees, ankles and feet
    place: float = 0.5  # of the distance below the cell
    visibility: float = 0.2
    spread: float = 0.1


@dataclass(frozen=True)
class TrainingConfig:
    """How to train. Raises InputError for impossible values."""

    minutes: float = 60.0  # how long to train; the learning rate falls over this time
    steps: int = 0  # if not 0: train this many steps instead of by the clock
    batch: int = 32  # views a step and process
    learning_rate: float = 1.5e-3  # at its highest
    warm_up: float = 0.04  # share of the training during which it rises
    weight_decay: float = 0.03
    average: float = 0.999  # decay a step of the averaged weights
    seed: int = 0
    validate_minutes: float = 4.0  # between two validations
    validation_views: int = 384
    checkpoint_minutes: float = 4.0
    compile: bool = False  # have torch compile the network first: minutes, then a third faster
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    loss: LossConfig = field(default_factory=LossConfig)

    def __post_init__(self) -> None:
        for name, good, valid in (
            ("minutes", self.minutes > 0, "above 0"),
            ("steps", self.steps >= 0, "0 or more"),
            ("batch", self.batch >= 2, "2 or more"),
            ("learning_rate", self.learning_rate > 0, "above 0"),
            ("average", 0 <= self.average < 1, "0 to 1"),
            ("seed", self.seed >= 0, "0 or more"),
        ):
            if not good:
                raise InputError(f"{name} {getattr(self, name)}", valid=valid)


FOR_A_RIG = ("; for a rig without footage, run egocap-eval train --rig RIG, "
             "or egocap-sim generate train-varied --rig RIG")  # fmt: skip


@dataclass(frozen=True)
class RunConfig:
    """What to train, on what, where. Raises InputError for values that contradict each other."""

    out: Path  # folder of the run
    data: Positional[tuple[Path, ...]] = ()  # sequences, or folders of sequences
    config: str = "default"  # network to train: default, small, paper (ResNet-101) or tiny
    held_out: float = 0.08  # share of the sequences to validate on and never train on
    start: Path | None = None  # weights to begin from: detector weights, or the folder of a run
    resume: bool = False  # go on with the run in --out, if there is one
    store: Path | None = None  # folder of the canonical views of the data; by default in --out
    backgrounds: tuple[Path, ...] = ()  # sequences whose images replace backgrounds; or the data's
    shares: tuple[float, ...] = ()  # how much of the training is on each DATA; or by its views

    def __post_init__(self) -> None:
        if not self.data:
            raise InputError(f"no footage to train on{FOR_A_RIG}", valid="folders of sequences")
        if not 0.0 <= self.held_out <= 0.5:
            raise InputError(f"held-out share {self.held_out}", valid="0 to 0.5")
        if self.shares and (len(self.shares) != len(self.data) or min(self.shares) <= 0):
            raise InputError(
                f"shares {', '.join(map(str, self.shares))} for {len(self.data)} folders of data",
                valid="one above 0 for each",
            )
