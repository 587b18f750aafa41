"""The wearer's proportions by the name of their source: a file, an average adult, or a fit."""

from __future__ import annotations

from pathlib import Path

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior, to_proportions

FORM = "a body file (json), average:HEIGHT, fit or fit:HEIGHT; HEIGHT in metres"
_FIT_S = 20.0
"""Seconds at the beginning that `fit` uses."""


def average_body(height: float | None = None) -> Proportions:
    """An adult of average proportions, of a height [m]. Raises InputError for no adult's height."""
    return to_proportions(BodyPrior.for_height(height).mean)


def find_body(source: str, rig: Rig | None = None, found: Detections | None = None) -> Proportions:
    """The proportions that `source` names, `FORM`. `fit` uses the first 20 s of the detections.

    Raises FileError for a file, InputError for another source or height, or to fit nothing.
    """
    kind, colon, rest = source.partition(":")
    if kind == "average" and rest:
        return average_body(_height(rest))
    if kind == "fit" and bool(colon) == bool(rest):
        if rig is None or found is None:
            raise InputError(
                "--body fit without a recording to fit", valid="a file or average:HEIGHT"
            )
        from egocap.commandline import progress
        from egocap.fitting.fit_body import BODY_PASSES, first_seconds, fit_body

        height, first = _height(rest) if rest else None, first_seconds(found, _FIT_S)
        with progress("fit-body", BODY_PASSES * len(first.times)) as advance:
            return fit_body(first, rig, height, on_frames=advance).proportions
    if not source.endswith(".json"):
        raise InputError(f"no body '{source}'", valid=FORM)
    return Proportions.load(Path(source))


def _height(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"a height of '{text}'", valid="metres, e.g. average:1.78") from None
