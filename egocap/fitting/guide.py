"""A guided fit: which pose to take next, until the bones of arms and legs are known well.

In: detections of instants, as they come. Out: what to ask of the wearer, and the fit so far. The
next pose is the one that shows the bones that are least certain; each is shown at least once, as
the errors of a detector in poses that are alike are alike.

Source: EgoCap 2016, section 4.1 (personalisation from three to four poses).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from egocap.body.labels import without_side
from egocap.body.skeleton import POINTS
from egocap.cameras.rig import Rig
from egocap.data.detections import Detections
from egocap.errors import InputError
from egocap.fitting.body_prior import BodyPrior
from egocap.fitting.config import FitConfig
from egocap.fitting.fit_body import WELL, BodyFit, fit_body

BONES = {"elbow": "upper arms", "wrist": "forearms", "knee": "thighs", "ankle": "shins"}
"""The bones that must be known, by the joint at their end."""
HOLD_S = 5.0
"""Time for a pose."""
_RATE = 10.0  # detections a second that are due
_TWICE = 2  # times that a pose is asked for at most


@dataclass(frozen=True)
class Request:
    """What the wearer is asked to do, and the bones that it shows best."""

    words: str
    shows: tuple[str, ...]  # joints at their ends


REQUESTS = (
    Request("stretch both arms forward; bend and stretch the elbows", ("elbow", "wrist")),
    Request("squat slowly, arms forward, and come up again", ("knee", "ankle")),
    Request("raise both arms sideways, and bend the elbows", ("elbow", "wrist")),
    Request("lift one knee high after the other", ("knee", "ankle")),
    Request("stand with one foot far in front, then the other; look at your feet", ("ankle",)),
)


class Guide:
    """Requests one after another. `request` is None when nothing is left to ask."""

    def __init__(
        self, rig: Rig, height: float | None = None, config: FitConfig = FitConfig()  # noqa: B008
    ) -> None:  # fmt: skip
        """Raises InputError for a height that no adult has."""
        BodyPrior.for_height(height)
        self._rig, self._height, self._config = rig, height, config
        self._found: list[Detections] = []
        self._asked: Counter[Request] = Counter()
        self.request: Request | None = REQUESTS[0]
        self.fit: BodyFit | None = None

    def due(self, time: float) -> bool:
        """Whether detections at a time [s] add something: poses that follow fast are alike."""
        return not self._found or time - self._found[-1].times[-1] >= 0.9 / _RATE

    def add(self, found: Detections) -> None:
        """Take in the detections of one more instant."""
        self._found.append(found)

    def advance(self) -> None:
        """Fit the body to what has been seen, and choose the next request."""
        assert self.request is not None
        self._asked[self.request] += 1
        if any(part.valid.any() for part in self._found):
            self.fit = fit_body(joined(self._found), self._rig, self._height, self._config)
        shown = {end for request in self._asked for end in request.shows}
        missing = {end: std for end, std in self.uncertainty().items()
                   if std > WELL or end not in shown}  # fmt: skip
        left = [r for r in REQUESTS if self._asked[r] < _TWICE and missing.keys() & set(r.shows)]
        self.request = max(left, default=None, key=lambda request: (
            sum(missing.get(end, 0.0) for end in request.shows) / (1 + self._asked[request])
        ))  # fmt: skip

    def uncertainty(self) -> dict[str, float]:
        """Relative standard deviation of the bones, of the worse side; 1 where it is a guess."""
        if self.fit is None:
            return dict.fromkeys(BONES, 1.0)
        std = np.where(self.fit.learned, self.fit.relative_std, 1.0)
        ends = [without_side(name) for name in POINTS]
        return {end: max(float(s) for s, at in zip(std, ends, strict=True) if at == end)
                for end in BONES}  # fmt: skip

    @property
    def finished(self) -> BodyFit:
        """The fit to all that was seen. Raises InputError if nothing was."""
        if self.fit is None:
            raise InputError("no body part was detected", valid="pictures that look down on the "
                             "wearer, in the order of the rig's views")  # fmt: skip
        return self.fit


def joined(parts: list[Detections]) -> Detections:
    """Detections one after another."""
    arrays = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, value in vars(parts[0]).items()
        if isinstance(value, np.ndarray)
    }
    return replace(parts[0], **arrays)
