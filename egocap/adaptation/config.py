"""Settings of `adapt`; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from egocap.errors import InputError


@dataclass(frozen=True)
class AdaptOptions:
    """What is known of the wearer, and how long to train. Raises InputError."""

    minutes: float = 10.0
    """Training time; the learning rate decays over it."""
    steps: int = 0
    """If not 0: number of training steps, instead of minutes."""
    height: float | None = None
    """Height of the wearer in metres."""
    body: str | None = None
    """Proportions of the wearer: a file of fit-body, or average:HEIGHT; fitted to the footage by
    default."""
    weights: Path | None = None
    """Detector weights to start from, safetensors; those shipped by default."""
    learning_rate: float = 1e-4
    """Peak learning rate."""
    views: int = 3000
    """Largest number of images to train on, evenly spread over the footage."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.body is not None and self.height is not None:
            raise InputError("--height and --body", valid="one of them")
        if self.height is not None:
            from egocap.fitting.wearer import average_body

            average_body(self.height)  # raises InputError for one that no adult has
        for name, good, valid in (
            ("minutes", 0.0 < self.minutes <= 10_000.0, "above 0, to 10000"),
            ("steps", self.steps >= 0, "0 or more"),
            ("learning_rate", 0.0 < self.learning_rate <= 1.0, "above 0, to 1"),
            ("views", self.views >= 1, "1 or more"),
            ("seed", self.seed >= 0, "0 or more"),
        ):
            if not good:
                option = name.replace("_", "-")
                raise InputError(f"--{option} {getattr(self, name)}", valid=valid)
