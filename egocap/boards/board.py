"""Calibration boards: checkerboards, ChArUco boards and AprilGrids.

Board frame: origin at the top-left corner of the pattern, x right, y down, z away from the viewer.
A board's corners are saddle points: four quadrants, black and white in turn.

Source: Garrido-Jurado et al. 2014 (ArUco) and OpenCV's ChArUco layout; Olson 2011 (AprilTag) and
the AprilGrid of Kalibr (Furgale et al. 2013), whose tags count from the bottom-left one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from egocap.errors import InputError

FORMS = (
    "checkerboard:COLUMNSxROWS:SQUARE, charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY], "
    "aprilgrid:COLUMNSxROWS:TAG:SPACING; counts of squares (tags), sizes in metres, "
    "SPACING as a fraction of the tag"
)
DICTIONARIES = tuple(f"{n}X{n}_{size}" for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000))
APRIL = "APRILTAG_36h11"
_APRIL_TAGS = 587
TAG_BORDER = 2  # black cells around a printed tag's bits, as Kalibr prints them
_MOST = 100  # squares along a side
_LARGEST = 5.0  # metres, side of a square


@dataclass(frozen=True)
class Board:
    """A flat board with K corners.

    Raises InputError for impossible counts and sizes, and for more markers than the dictionary has.
    """

    kind: str  # "checkerboard", "charuco" or "aprilgrid"
    columns: int  # squares or tags along x
    rows: int
    square: float  # metres: side of a square, or of a tag's black border
    inner: float | None = None  # ChArUco: side of a marker [m]; AprilGrid: gap over tag size
    dictionary: str = ""  # of the markers

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"unknown board '{self.kind}'", valid=FORMS)
        least = 1 if self.kind == "aprilgrid" else 3
        if not all(least <= n <= _MOST for n in (self.columns, self.rows)):
            raise InputError(f"a board of {self.columns} x {self.rows}",
                             valid=f"{least} to {_MOST} on each side")  # fmt: skip
        if not 0.001 <= self.square <= _LARGEST:
            raise InputError(f"squares of {self.square:g} m",
                             valid="metres, 0.001 to 5: 32.5 mm are 0.0325")  # fmt: skip
        if self.kind == "charuco" and not 0.2 * self.square < (self.inner or 0) < self.square:
            raise InputError(f"markers of {self.inner or 0:g} m in squares of {self.square:g} m",
                             valid="markers smaller than the squares, in metres")  # fmt: skip
        if self.kind == "aprilgrid" and not 0.05 <= (self.inner or 0) <= 1.0:
            raise InputError(f"a spacing of {self.inner or 0:g}",
                             valid="gap over tag size, 0.05 to 1")  # fmt: skip
        self._check_dictionary()

    def _check_dictionary(self) -> None:
        if self.kind == "checkerboard":
            return
        valid = DICTIONARIES if self.kind == "charuco" else (APRIL,)
        if self.dictionary not in valid:
            raise InputError(f"unknown dictionary '{self.dictionary}'", valid=valid)
        if self.rows > self.most_rows:
            raise InputError(
                f"{self.columns} x {self.rows} need more markers than {self.dictionary} has",
                valid=f"at most {_size(self.dictionary)} markers: {self.most_rows} rows at "
                f"{self.columns} columns",
            )

    def __str__(self) -> str:
        numbers = [f"{n:g}" for n in (self.square, self.inner) if n is not None]
        words = [self.kind, f"{self.columns}x{self.rows}", *numbers]
        return ":".join(words + [self.dictionary] * (self.kind == "charuco"))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the pattern, metres."""
        if self.kind != "aprilgrid":
            return self.columns * self.square, self.rows * self.square
        step, gap = self.square * (1 + self.inner), self.square * self.inner  # type: ignore
        return self.columns * step + gap, self.rows * step + gap

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of the inner corners; of an AprilGrid, of all tag corners."""
        if self.kind == "aprilgrid":
            return 2 * self.columns, 2 * self.rows
        return self.columns - 1, self.rows - 1

    @cached_property
    def points(self) -> Float[Array, "K 3"]:
        """Corners: row by row from the top left; of an AprilGrid, four a tag in order of tags."""
        if self.kind == "aprilgrid":
            flat = np.concatenate(list(self.markers.values()))
        else:
            columns, rows = self.grid
            y, x = np.mgrid[1 : rows + 1, 1 : columns + 1]
            flat = self.square * np.stack([x.ravel(), y.ravel()], -1)
        return np.column_stack([flat, np.zeros(len(flat))])

    @cached_property
    def polarity(self) -> Int[Array, "K"]:
        """+1 where the quadrant right of and below the corner is black, -1 where it is white."""
        if self.kind == "aprilgrid":
            return np.tile([1, -1, 1, -1], self.columns * self.rows)
        columns, rows = self.grid
        y, x = np.mgrid[:rows, :columns]
        return np.where((x + y) % 2 == 0, 1, -1).ravel()

    @property
    def reach(self) -> float:
        """Half the side of the square around a corner that only its four quadrants cover, metres.

        Along the two edges themselves the quadrants reach farther: to `edge_reach`.
        """
        if self.kind == "checkerboard":
            return 0.5 * self.square
        if self.kind == "charuco":
            return 0.5 * (self.square - self.inner)  # type: ignore[operator]
        return self.square * min(2 / 10, self.inner or 0.0)

    @property
    def edge_reach(self) -> float:
        """Length of a corner's edges that its neighbours do not share, metres."""
        return self.reach if self.kind == "aprilgrid" else 0.5 * self.square

    @cached_property
    def markers(self) -> dict[int, Float[Array, "4 2"]]:
        """Corners of each marker by its number: clockwise from the top left, x and y in metres."""
        if self.kind == "charuco":
            side, gap = self.inner or 0.0, 0.5 * (self.square - (self.inner or 0.0))
            cells = [(c, r) for r in range(self.rows) for c in range(self.columns) if (c + r) % 2]
            origins = [(c * self.square + gap, r * self.square + gap) for c, r in cells]
        elif self.kind == "aprilgrid":
            side, gap = self.square, self.square * (self.inner or 0.0)
            step = side + gap
            origins = [(gap + c * step, gap + (self.rows - 1 - r) * step)
                       for r in range(self.rows) for c in range(self.columns)]  # fmt: skip
        else:
            return {}
        box = side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        return {i: np.array(origin) + box for i, origin in enumerate(origins)}

    @property
    def most_rows(self) -> int:
        """Rows of these columns for which the dictionary has markers."""
        if self.kind == "checkerboard":
            return _MOST
        cells = 2 * _size(self.dictionary) + 1 if self.kind == "charuco" else _size(APRIL)
        return min(_MOST, cells // self.columns)

    @property
    def symmetric(self) -> bool:
        """Whether the board looks the same after half a turn."""
        return self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0

    @property
    def cv_dictionary(self) -> Any:
        """OpenCV's dictionary of the markers."""
        import cv2

        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{self.dictionary}"))

    def black(self) -> Float[Array, "M 4"]:
        """The black rectangles: x, y, width, height in metres."""
        if self.kind == "aprilgrid":
            return np.concatenate([self._gap_squares(), *self._marker_cells(TAG_BORDER)])
        squares = [(c * self.square, r * self.square, self.square, self.square)
                   for r in range(self.rows) for c in range(self.columns)
                   if (c + r) % 2 == 0]  # fmt: skip
        return np.concatenate([np.array(squares), *self._marker_cells(1)])

    def _gap_squares(self) -> Float[Array, "M 4"]:
        """The small squares between the tags of an AprilGrid, which make corners of theirs."""
        gap = self.square * (self.inner or 0.0)
        step = self.square + gap
        rows, columns = np.mgrid[: self.rows + 1, : self.columns + 1] * step
        sides = np.full(rows.size, gap)
        return np.column_stack([columns.ravel(), rows.ravel(), sides, sides])

    def _marker_cells(self, border: int) -> list[Float[Array, "M 4"]]:
        """Black runs of cells in the rows of every marker.

        Kalibr prints tags turned by half a turn against OpenCV's drawing.
        """
        turns = 2 if self.kind == "aprilgrid" else 0
        cells = []
        for number, corners in self.markers.items():
            n = self.cv_dictionary.markerSize + 2 * border
            image = self.cv_dictionary.generateImageMarker(number, n, borderBits=border)
            side = (corners[1, 0] - corners[0, 0]) / n
            for r, row in enumerate(np.rot90(image, turns) < 128):
                edges = np.flatnonzero(np.diff(np.r_[0, row.astype(np.int8), 0]))
                runs = edges.reshape(-1, 2)
                cells += [(corners[0, 0] + a * side, corners[0, 1] + r * side, (b - a) * side, side)
                          for a, b in runs]  # fmt: skip
        return [np.array(cells)] if cells else []


def parse_board(text: str) -> Board:
    """Read a board from text such as `charuco:5x7:0.0325:0.024`. Raises InputError.

    Columns and rows count squares (tags of an AprilGrid), as a person counts them on the print.
    """
    kind, *words = text.strip().split(":")
    if kind not in KINDS:
        raise InputError(f"unknown board '{kind}'", valid=FORMS)
    least, most = KINDS[kind]
    try:
        if not least <= len(words) <= most:
            raise ValueError
        columns, rows = (int(n) for n in words[0].lower().split("x"))
        sizes = [float(w) for w in words[1:least]]
    except ValueError:
        raise InputError(f"cannot read the board '{text}'", valid=FORMS) from None
    named = words[least].upper().removeprefix("DICT_") if len(words) > least else ""
    if named and named not in DICTIONARIES:
        raise InputError(f"unknown dictionary '{words[least]}'", valid=DICTIONARIES)
    dictionary = {"charuco": named or _dictionary_for(columns * rows // 2), "aprilgrid": APRIL}
    return Board(kind, columns, rows, *sizes, dictionary=dictionary.get(kind, ""))  # type: ignore


KINDS = {"checkerboard": (2, 2), "charuco": (3, 4), "aprilgrid": (3, 3)}
"""Fewest and most words after the name of a kind."""


def _size(dictionary: str) -> int:
    """Markers of a dictionary."""
    return _APRIL_TAGS if dictionary == APRIL else int(dictionary.rpartition("_")[2])


def _dictionary_for(markers: int) -> str:
    return next((f"4X4_{n}" for n in (50, 100, 250, 1000) if markers <= n), "4X4_1000")
