"""Pictures of all views on a common time base: the frames of a sequence.

Frames follow the first view's pictures; where it lost some, instants in between stand for them. A
view contributes the picture nearest in time, if it is nearer than half its period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from egocap.data.footage import FrameTimes, ViewTiming
from egocap.errors import InputError
from egocap.footage.config import Range
from egocap.footage.scan import ViewScan
from egocap.series import nearest

REPEATED = 0.15
"""Change of a picture, relative to what is usual, below which it repeats the one before."""
SAME = 0.5  # grey levels: a copy changes by no more, compressed again
COARSE = 0.8  # grey levels: nor does one that is compressed coarsely
_DIP = 0.6  # of the changes around it: of a copy in a calm scene
_FLOOR, _BELOW_FLOOR = 0.02, 0.75
"""Quantile of a view's changes that noise alone makes; a copy has none and stays well below."""
BLACK = 6.0  # mean grey level of a picture that shows nothing
_TICK_S = 1e-6  # by which times may differ in rounding
_SLACK_S = 1e-3  # by which views may begin and end apart
_NEAR = 0.55  # of a period: half of it, and jitter


@dataclass(frozen=True, eq=False)
class ViewFrames:
    """The pictures of a view, by the common clock."""

    time: Float[Array, "N"]  # s, common
    usable: Bool[Array, "N"]
    repeated: Bool[Array, "N"]
    black: Bool[Array, "N"]
    period: float

    @property
    def span(self) -> tuple[float, float]:
        """Common times of the first and the last usable picture."""
        good = self.time[self.usable]
        return (float(good[0]), float(good[-1])) if len(good) else (np.inf, -np.inf)


def view_frames(scans: Sequence[ViewScan], timings: Sequence[ViewTiming]) -> list[ViewFrames]:
    """Pictures of every view by the common clock, without repeated and black ones."""
    times = [timing.to_common(scan.time) for scan, timing in zip(scans, timings, strict=True)]
    found = []
    for v, scan in enumerate(scans):
        usual = _usual_change(scan)
        for w, other in enumerate(scans):
            if w != v:  # a still scene repeats in all views
                usual = np.minimum(usual, np.interp(times[v], times[w], _smoothed(other)))
        copied = scan.change < np.minimum(REPEATED * usual, SAME)
        repeated = scan.decoded & (copied | _noiseless(scan))
        black = scan.decoded & (scan.light < BLACK)
        usable = scan.decoded & ~repeated & ~black
        found.append(ViewFrames(times[v], usable, repeated, black, scan.period))
    return found


def pair(views: Sequence[ViewFrames], wanted: Range, names: Sequence[str]) -> FrameTimes:
    """The frames of a sequence, and which picture of every view belongs to each.

    Raises InputError where the views have no time in common, or one of them, by its name, has no
    usable picture.
    """
    for name, view in zip(names, views, strict=True):
        if not view.usable.any():
            raise InputError(f"'{name}' has no usable picture: all are black, damaged or frozen",
                             valid="footage in every view")  # fmt: skip
    first, last = _common(views, wanted)
    grid = _instants(views[0], first, last)
    if len(grid) < 2:
        raise InputError(f"no frames between {first:.2f} and {last:.2f} s",
                         valid="--start and --end within the footage")  # fmt: skip
    T, V = len(grid), len(views)
    source, taken, present = np.zeros((T, V), int), np.zeros((T, V)), np.zeros((T, V), bool)
    for v, view in enumerate(views):
        places = np.flatnonzero(view.usable)
        if len(places):
            near = places[nearest(view.time[places], grid)]
            source[:, v], taken[:, v] = near, view.time[near]
            present[:, v] = np.abs(view.time[near] - grid) < _NEAR * max(view.period, 1e-6)
            again = np.flatnonzero(near[1:] == near[:-1]) + 1  # a slower view: once
            nearer = np.abs(taken[again, v] - grid[again]) < np.abs(taken[again - 1, v]
                                                                    - grid[again - 1])  # fmt: skip
            present[np.where(nearer, again - 1, again), v] = False
    return FrameTimes(grid, taken, source, present)


def _common(views: Sequence[ViewFrames], wanted: Range) -> tuple[float, float]:
    spans = [view.span for view in views]
    starts, ends = zip(*spans, strict=True)
    join = (min, max) if wanted.keep_single else (max, min)
    first, last = join[0](starts), join[1](ends)
    if last <= first:
        described = ", ".join(f"{a:.2f} to {b:.2f} s" for a, b in spans)
        raise InputError(f"the views have no time in common: {described}",
                         valid="recordings of the same minutes, or the right --lag")  # fmt: skip
    start = -np.inf if wanted.start is None else wanted.start - _TICK_S
    end = np.inf if wanted.end is None else wanted.end + _TICK_S
    return max(first - _SLACK_S, start), min(last + _SLACK_S, end)


def _instants(view: ViewFrames, first: float, last: float) -> Float[Array, "T"]:
    """Times of the view's pictures, and even steps where it has none."""
    good, step = view.time[view.usable], view.period
    if not len(good):
        return np.arange(first, last, step)
    lead = good[0] - step * np.arange(max(int((good[0] - first) / step), 0), 0, -1)
    tail = good[-1] + step * np.arange(1, max(int((last - good[-1]) / step), 0) + 1)
    known = np.concatenate([lead, good, tail])
    filled = [
        np.linspace(a, b, max(round((b - a) / step), 1), endpoint=False)
        for a, b in pairwise(known)
    ]  # fmt: skip
    times = np.concatenate([*filled, known[-1:]])
    return times[(times >= first) & (times <= last)]


def _usual_change(scan: ViewScan) -> float:
    return float(np.median(_finite(scan))) if scan.decoded.sum() > 1 else 0.0


def _noiseless(scan: ViewScan) -> Bool[Array, "N"]:
    """Single pictures that change less than those around them, and less than noise makes any."""
    if scan.decoded.sum() < 1 / _FLOOR:
        return np.zeros(len(scan.change), bool)
    floor = float(np.quantile(_finite(scan), _FLOOR))
    limit = np.minimum(_DIP * _smoothed(scan), min(_BELOW_FLOOR * floor, COARSE))
    return scan.change < limit


def _finite(scan: ViewScan) -> Float[Array, "n"]:
    change = scan.change[scan.decoded]
    return change[np.isfinite(change)]


def _smoothed(scan: ViewScan, width: int = 5) -> Float[Array, "N"]:
    """Median change around every picture."""
    from scipy.ndimage import median_filter

    change = np.where(np.isfinite(scan.change) & scan.decoded, scan.change, 0.0)
    return median_filter(change, size=width, mode="nearest")
