"""Settings of a training run; field comments are the command line's help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from tyro.conf import Positional

from egocap.errors import InputError


@dataclass(frozen=True)
class AugmentationConfig:
    """Augmentation of training images. Probabilities are per image."""

    background: float = 0.25  # probability of another background
    recolour: float = 0.5  # probability of other colours of clothes and skin
    camouflage: float = 0.15  # probability of a garment in the colour of its background
    scale: float = 0.15  # largest relative scaling
    rotation_deg: float = 8.0  # largest rotation
    shift: float = 0.04  # largest shift, fraction of the image width
    gamma: float = 2.0  # largest gamma; the smallest is its inverse
    colour: float = 0.5  # probability of another colour temperature, saturation and contrast
    blur: float = 0.3  # probability of blur, half of it motion blur
    noise: float = 0.5  # probability of sensor noise
    jpeg: float = 0.2  # probability of JPEG compression
    occluders: float = 0.2  # probability of occluders
    exposure: float = 0.3  # probability of another exposure, which may clip
    grey: float = 0.12  # probability of a monochrome camera
    rim: float = 0.15  # probability of a dark rim outside a round mask
    aberration: float = 0.15  # probability of lateral chromatic aberration
    flare: float = 0.1  # probability of lens flare


NO_AUGMENTATION = AugmentationConfig(0, 0, 0, 0, 0, 0, 1, *(0,) * 10)
"""No augmentation."""


@dataclass(frozen=True)
class LossConfig:
    """Weights of the loss terms, and widths of the targets."""

    seen_cells: float = 0.75  # standard deviation of the target of a visible label, cells
    hidden_cells: float = 1.25  # the same of an occluded label, cells
    hidden: float = 0.5  # weight of occluded labels
    extremities: float = 1.5  # weight of wrists, hands, knees, ankles and feet
    place: float = 0.5  # weight of the sub-cell distance
    visibility: float = 0.2
    spread: float = 0.1


@dataclass(frozen=True)
class TrainingConfig:
    """How to train. Raises InputError for values out of range."""

    minutes: float = 60.0  # training time; the learning rate decays over it
    steps: int = 0  # if not 0: number of steps, instead of minutes
    batch: int = 32  # views per step and process
    learning_rate: float = 1.5e-3  # peak learning rate
    warm_up: float = 0.04  # fraction of the training during which the learning rate rises
    weight_decay: float = 0.03
    average: float = 0.999  # decay per step of the averaged weights
    seed: int = 0
    validate_minutes: float = 4.0  # minutes between validations
    validation_views: int = 384
    checkpoint_minutes: float = 4.0
    compile: bool = False  # compile the network with torch: takes minutes, then a third faster
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
    """Network, data and folder of a run. Raises InputError for contradictory values."""

    out: Path  # folder of the run
    data: Positional[tuple[Path, ...]] = ()  # sequences, or folders of sequences
    config: str = "default"  # network to train: default, small, paper (ResNet-101) or tiny
    held_out: float = 0.08  # fraction of the sequences held out for validation
    start: Path | None = None  # initial weights: detector weights, or the folder of a run
    resume: bool = False  # resume the run in --out, if there is one
    store: Path | None = None  # folder for canonical views of the data; default: in --out
    backgrounds: tuple[Path, ...] = ()  # sequences for backgrounds; default: DATA
    shares: tuple[float, ...] = ()  # weight of each DATA in training; default: its views

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
