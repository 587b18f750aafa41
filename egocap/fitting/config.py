"""Settings of `fit_body`; the command line shows the comments as help."""

from __future__ import annotations

from dataclasses import dataclass

from egocap.errors import InputError


@dataclass(frozen=True)
class FitConfig:
    """Settings of the fit; those of the tracker hold for its energy."""

    frames: int = 60
    """Frames that take part, spread over all those given."""
    iterations: int = 40
    """Steps at most."""
    tolerance: float = 1e-5
    """Done when a step lowers the energy by less than this share."""

    def __post_init__(self) -> None:
        for name in ("frames", "iterations"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} = {getattr(self, name)}", valid="from 1")
        if not 0.0 <= self.tolerance < 1.0:
            raise InputError(f"tolerance = {self.tolerance}", valid="0 to 1")
