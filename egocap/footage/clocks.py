"""Clock and colours of every view: as given, or estimated from the scans of its pictures."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from egocap.data.footage import FootageView, ViewColour, ViewTiming
from egocap.errors import InputError
from egocap.footage.config import ImportOptions
from egocap.footage.pairing import REPEATED
from egocap.footage.photometry import estimate_colour
from egocap.footage.scan import ViewScan
from egocap.footage.signals import ViewSignals, light_signal, rotation_signal, sound_signal
from egocap.footage.synchronisation import estimate_clock
from egocap.media.sound import read_sound

log = logging.getLogger(__name__)


def find_clocks(
    options: ImportOptions, scans: Sequence[ViewScan], views: Sequence[FootageView]
) -> list[ViewTiming]:
    """Clock of every view against the first's. Raises InputError for a wrong number of values.

    Views that share a file share its clock. A clock that cannot be estimated is assumed equal to
    the first's, with a warning and a note that gives the reason.
    """
    if options.drift and not options.lag and not options.side_by_side:
        raise InputError("--drift without --lag", valid="both, or neither")
    if options.lag or options.drift:
        return _given(options, len(scans))
    if options.side_by_side:
        return [ViewTiming(note="the views share a file") for _ in scans]
    first, *others = (
        view_signals(s, Path(view.path)) for s, view in zip(scans, views, strict=True)
    )
    found = [ViewTiming()]
    for view, other in zip(views[1:], others, strict=True):
        estimate = estimate_clock(first, other)
        if estimate.problem and estimate.timing.origin == "estimated":
            log.warning("%s: %s; longer footage in which the head turns, or --lag, makes it sure",
                        view.name, estimate.problem)  # fmt: skip
        elif estimate.problem:
            log.warning("%s: clock assumed equal to that of %s (%s); set --lag where it is not",
                        view.name, views[0].name, estimate.problem)  # fmt: skip
        found.append(estimate.timing)
    return found


def find_colours(
    options: ImportOptions, scans: Sequence[ViewScan], timings: Sequence[ViewTiming]
) -> list[ViewColour]:
    """Gain of every view against the first. Raises InputError for a wrong number of values."""
    _check_count("--gains", options.gains, len(scans), each=3)
    if options.gains:
        rows = np.reshape(options.gains, (-1, 3))
        return [ViewColour()] + [
            ViewColour(gain=(float(r), float(g), float(b)), origin="given") for r, g, b in rows
        ]
    first = scans[0]
    return [ViewColour()] + [
        estimate_colour(first.time, first.colour, timing.to_common(scan.time), scan.colour)
        for scan, timing in zip(scans[1:], timings[1:], strict=True)
    ]


def _given(options: ImportOptions, views: int) -> list[ViewTiming]:
    """Clocks as given: own time = lag + (1 + drift) x common time."""
    for name, values in (("--lag", options.lag), ("--drift", options.drift)):
        _check_count(name, values, views)
    found = [ViewTiming()]
    for v in range(views - 1):
        lag, drift = ((*values, *[0.0] * views)[v] for values in (options.lag, options.drift))
        rate = 1.0 / (1.0 + 1e-6 * drift)
        found.append(ViewTiming(offset_s=-lag * rate, drift_ppm=1e6 * (rate - 1.0), origin="given"))
    return found


def _check_count(name: str, values: Sequence[float], views: int, each: int = 1) -> None:
    if len(values) not in (0, each * (views - 1)):
        what = "one for each view" if each == 1 else f"{each} for each view"
        raise InputError(f"{len(values)} values of {name}",
                         valid=f"{each * (views - 1)}, {what} after the first")  # fmt: skip


def view_signals(scan: ViewScan, heard_in: Path | None) -> ViewSignals:
    """What a view shows of its clock; `heard_in` is its file, None to leave its sound out."""
    fresh = _fresh(scan)
    heard = None if heard_in is None or heard_in.is_dir() else read_sound(heard_in)
    return ViewSignals(
        rotation_signal(scan.time, scan.turn, fresh), light_signal(scan.time, scan.light, fresh),
        None if heard is None else sound_signal(*heard.loudness()), heard,
    )  # fmt: skip


def _fresh(scan: ViewScan) -> Bool[Array, "N"]:
    """Decoded pictures that do not repeat the one before."""
    change = np.where(np.isfinite(scan.change), scan.change, np.inf)
    usual = float(np.median(change[scan.decoded])) if scan.decoded.any() else 0.0
    return scan.decoded & (change >= REPEATED * usual)
