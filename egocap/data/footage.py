"""Where the pictures of a sequence of footage are, and when each was taken.

footage.json names every view's video or folder of pictures, its clock and its colours against the
first view's. times.npz holds the times of the sequence's frames, and which picture of every view
belongs to each.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8
from numpy import ndarray as Array
from pydantic import Field

from egocap.data.arrays import FrameArrays
from egocap.errors import FileError
from egocap.media.pictures import PictureOptions
from egocap.media.source import Part, PictureSource, open_source
from egocap.schema import Strict, checked, read_json, refuse_newer

SCHEMA = 1
FOOTAGE = "footage.json"
TIMES = "times.npz"
Origin = Literal["assumed", "estimated", "given"]


class ViewTiming(Strict):
    """The clock of a view: common time = offset_s + (1 + drift_ppm / 10^6) x own time."""

    offset_s: float = 0.0
    drift_ppm: float = 0.0
    offset_std_s: float | None = Field(default=None, ge=0)
    drift_std_ppm: float | None = Field(default=None, ge=0)
    origin: Origin = "assumed"
    note: str = ""  # how it was estimated, or why it could not be

    def to_common(self, own: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Common times of times by the view's own clock [s]."""
        return self.offset_s + (1.0 + 1e-6 * self.drift_ppm) * np.asarray(own)


class ViewColour(Strict):
    """Factors on recorded red, green and blue that bring a view's colours to the first view's."""

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    origin: Origin = "assumed"

    def applied(self, image: UInt8[Array, "H W 3"]) -> UInt8[Array, "H W 3"]:
        """The image with its colours multiplied, rounded and clipped."""
        import cv2

        if self.gain == (1.0, 1.0, 1.0):
            return image
        values = np.arange(256)[:, None] * np.array(self.gain)
        table = np.clip(np.rint(values), 0, 255).astype(np.uint8)[None]
        return cv2.LUT(np.ascontiguousarray(image), table)  # pyright: ignore[reportReturnType]


class FootageView(Strict):
    """The pictures of one view."""

    name: str
    path: str  # of the video or folder, absolute
    part: Part = Part()  # of several views side by side
    options: PictureOptions = PictureOptions()
    bytes: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    timing: ViewTiming = ViewTiming()
    colour: ViewColour = ViewColour()


class Footage(Strict):
    """footage.json."""

    kind: Literal["egocap-footage"] = "egocap-footage"
    schema_version: int = Field(default=SCHEMA, ge=1)
    views: tuple[FootageView, ...]
    report: dict[str, dict[str, float]] = {}  # by view: pictures, dropped, repeated, damaged, ...


@dataclass(frozen=True, eq=False)
class FrameTimes(FrameArrays):
    """times.npz: the frames of a sequence of footage and their pictures. Axis V: views."""

    time: Float[Array, "T"]  # s, common
    taken: Float[Array, "T V"]  # s, common: of the picture; meaningful where `present`
    source: Int64[Array, "T V"]  # place of the picture in its source; meaningful where `present`
    present: Bool[Array, "T V"]  # whether the view has a picture of this frame

    def __getitem__(self, rows: slice) -> FrameTimes:
        """A range of frames; arrays are views of these."""
        return FrameTimes(*(getattr(self, f.name)[rows] for f in fields(self)))


def load_footage(path: Path) -> Footage:
    """Read footage.json. Raises FileError."""
    data = read_json(path)
    refuse_newer(data, SCHEMA, path)
    found = checked(Footage, data, path)
    for view in found.views:
        if not 0 <= view.part.place < view.part.of:
            raise FileError(path, f"part {view.part.place} of {view.part.of}",
                            key=f"views.{view.name}.part", valid="e.g. 0 of 2")  # fmt: skip
    return found


class FootageImages:
    """Pictures of footage by frame. A file that holds several views is decoded once."""

    def __init__(self, footage: Footage, times: FrameTimes) -> None:
        self.footage, self.times = footage, times
        self._sources: dict[str, PictureSource] = {}
        self._last: dict[str, tuple[int, UInt8[Array, "H W 3"] | None]] = {}

    def image(self, index: int, view: int) -> UInt8[Array, "H W 3"] | None:
        """RGB image as recorded; None where it is missing or damaged. Raises FileError."""
        if not self.times.present[index, view]:
            return None
        entry = self.footage.views[view]
        picture = self._picture(entry, int(self.times.source[index, view]))
        return None if picture is None else picture[:, entry.part.columns(picture.shape[1])]

    def _picture(self, entry: FootageView, place: int) -> UInt8[Array, "H W 3"] | None:
        if entry.path not in self._sources:
            _require_same(entry)
            self._sources[entry.path] = open_source(entry.path, entry.options)
        count = len(self._sources[entry.path].times)
        if not 0 <= place < count:
            raise FileError(entry.path, f"has no picture {place}", valid=f"0 to {count - 1}")
        last = self._last.get(entry.path)
        if last is None or last[0] != place:
            last = self._last[entry.path] = place, self._sources[entry.path].image(place)
        return last[1]


def _require_same(entry: FootageView) -> None:
    path = Path(entry.path)
    if not (path.exists() and entry.bytes):  # a data set's pictures are not counted
        return
    files = path.iterdir() if path.is_dir() else [path]
    if sum(file.stat().st_size for file in files if file.is_file()) != entry.bytes:
        raise FileError(path, "is not as it was imported",
                        valid="what was imported, or egocap import again")  # fmt: skip
