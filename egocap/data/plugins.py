"""Plug-ins for other detectors and trackers: two call signatures, two entry-point groups.

A package names its function in its pyproject.toml,

    [project.entry-points."egocap.trackers"]
    mine = "my_package:track"

and `egocap-eval pose SEQ --tracker mine` (or, without installation, `--tracker my_package:track`)
runs and scores it. Plug-ins have no access to the truth.

A detector takes a `SequenceView` and returns `Detections`. A tracker takes a `SequenceView` and the
detections of --detections, None without that option, and returns a `Track` or joints in the head
frame: (T, 18, 3) in metres, in the order of `labels.LABELS`, NaN for unknown joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from egocap.body.proportions import Proportions
from egocap.cameras.rig import Rig
from egocap.data.sequence import Frame, Sequence
from egocap.errors import InputError

DETECTORS, TRACKERS = "egocap.detectors", "egocap.trackers"


class SequenceView:
    """A sequence without truth: images, times, cameras, body proportions."""

    def __init__(self, sequence: Sequence) -> None:
        self._frame = sequence.frame
        self.rig: Rig = sequence.rig
        self.body: Proportions = sequence.body
        self.times: Float[Array, "T"] = sequence.times

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[Frame]:
        return (self._frame(i) for i in range(len(self)))

    def frame(self, index: int) -> Frame:
        """Images of one frame."""
        return self._frame(index)

    def images(self, index: int) -> tuple[UInt8[Array, "H W 3"], ...]:
        """RGB images of all views at a frame, as `egocap.track.tracker.track` takes them."""
        return self._frame(index).images


def installed(group: str) -> list[str]:
    """Names of the installed plug-ins of a group."""
    return sorted({point.name for point in entry_points(group=group)})


def find_plugin(group: str, name: str) -> Callable[..., Any]:
    """Find the function of an installed plug-in, or of "module:function".

    Raises:
        InputError: it is missing, cannot be imported, or is not a function.
    """
    for point in entry_points(group=group):
        if point.name == name:
            return _loaded(point.load, name)
    module, colon, attribute = name.partition(":")
    if not (module and colon and attribute):
        names = [*installed(group), "MODULE:FUNCTION"]
        raise InputError(f"no plug-in '{name}' in {group}", valid=names)
    return _loaded(lambda: getattr(import_module(module), attribute), name)


def _loaded(load: Callable[[], Any], name: str) -> Callable[..., Any]:
    try:
        found = load()
    except (ImportError, AttributeError) as error:
        raise InputError(f"plug-in '{name}' cannot be loaded: {error}",
                         valid="a module on PYTHONPATH, or a plug-in") from None  # fmt: skip
    if not callable(found):
        raise InputError(f"plug-in '{name}' is a {type(found).__name__}", valid="a function")
    return found
