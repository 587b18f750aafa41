"""How to train: every setting, with what the command line says of it. Nothing heavy is imported."""

from __future__ import annotations

from dataclasses import dataclass, field

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
