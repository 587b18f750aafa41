"""Details painted on garments: seams, hems, cuffs, plackets, zips, pockets, belts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from egocap_sim.human.body.body_chart import ARMS, LEGS, TORSO
from egocap_sim.human.clothing.panels import GIRTH, REACH, Panel

LINE = cv2.LINE_8  # without anti-aliasing: the same bytes with every build of OpenCV
STITCH, SEAM = -0.22, -0.3  # relief of a stitched line and of a seam
FRONT = 0.5  # turn of the middle of the front


@dataclass(frozen=True)
class Marks:
    """Positions of details (m): heights on the torso, minus distances along limbs."""

    crotch: float = 0.8
    waist: float = 1.0
    chest: float = 1.3
    neck: float = 1.45
    elbow: float = -0.28
    knee: float = -0.42
    accent: tuple[float, float, float] = (40.0, 36.0, 34.0)  # sRGB 0-255 of belt, buttons, print

    def creases(self, panel: Panel) -> list[tuple[float, float, float]]:
        """Bands of folds on a panel: centre (m), width (m), strength."""
        if panel.piece == TORSO:
            return [(self.waist, 0.07, 0.6), (panel.bottom, 0.05, 0.3)]
        joint = self.elbow if panel.piece in ARMS else self.knee
        found = [(panel.top, 0.06, 0.5)]
        if panel.bottom < joint:
            found.append((joint, 0.055, 1.0))
        if panel.bottom < 1.6 * joint:  # long sleeves and legs bunch at the end
            found.append((panel.bottom + 0.03, 0.05, 0.9))
        return found


@dataclass(eq=False)
class Canvas:
    """A panel being painted: colours (0-255) and a relief that shades them later."""

    panel: Panel
    image: Float[Array, "H W 3"]
    marks: Marks
    rng: np.random.Generator
    relief: Float[Array, "H W"] = field(init=False)

    def __post_init__(self) -> None:
        self.relief = np.zeros(self.image.shape[:2], np.float32)

    @property
    def top(self) -> float:
        """Metres along the piece at the upper edge."""
        return self.panel.top

    @property
    def bottom(self) -> float:
        """Metres along the piece at the lower edge."""
        return self.panel.bottom

    def px(self, turn: float, along: float) -> tuple[int, int]:
        """Pixel of a position on the panel."""
        return round(float(self.panel.x(turn))), round(float(self.panel.y(along)))

    def rows(self, length: float) -> int:
        """Length (m) in rows, at least one."""
        return max(1, round(length / (self.top - self.bottom) * self.panel.height))

    def columns(self, length: float) -> int:
        """Length (m) in columns."""
        return round(float(self.panel.x(self.turns(length))))

    def turns(self, length: float) -> float:
        """Length (m) around the piece in turns."""
        return length / GIRTH[self.panel.piece]

    def line(self, places: list[tuple[float, float]], strength: float, width: int = 1) -> None:
        """Draw a polyline into the relief."""
        points = np.array([self.px(*p) for p in places], np.int32)
        cv2.polylines(self.relief, [points], False, strength, width, LINE)

    def line_around(self, along: float, strength: float, width: int = 1) -> None:
        """Draw a line around the piece into the relief."""
        self.line([(0, along), (REACH, along)], strength, width)

    def line_down(self, turn: float, strength: float, width: int = 1) -> None:
        """Draw a line from the upper to the lower edge into the relief."""
        self.line([(turn, self.top), (turn, self.bottom)], strength, width)

    def band(self, low: float, high: float) -> slice:
        """Rows between two positions along the piece."""
        first, last = sorted((self.px(0, high)[1], self.px(0, low)[1]))
        return slice(max(first, 0), max(last, 0))

    def dye(self, color: tuple[float, float, float], share: Float[Array, "H #W 1"]) -> None:
        """Blend a colour (0-255) into the image."""
        self.image += share * (np.array(color, np.float32) - self.image)


def hems(canvas: Canvas) -> None:
    """A stitched line above the lower edge."""
    place = canvas.bottom + 0.022
    if canvas.top - canvas.bottom > 0.06:
        canvas.line_around(place, STITCH)
        canvas.relief[canvas.band(canvas.bottom, place)] += 0.04


def ribs(canvas: Canvas) -> None:
    """Ribbed cuffs and waistband."""
    place = canvas.bottom + 0.055
    count = round(GIRTH[canvas.panel.piece] / 0.012)
    wave = 0.12 * np.sign(np.sin(2 * np.pi * canvas.panel.turns * count))
    canvas.relief[canvas.band(canvas.bottom, place)] += wave[None, :].astype(np.float32) - 0.05
    canvas.line_around(place, SEAM, 2)


def side_seams(canvas: Canvas) -> None:
    """Seams at the sides of torso and legs, and under the arms."""
    for turn in (0.02,) if canvas.panel.piece in ARMS else (0.25, 0.75):
        canvas.line_down(turn, SEAM)


def placket(canvas: Canvas) -> None:
    """A band down the front with buttons."""
    half = canvas.turns(0.017)
    for turn in (FRONT - half, FRONT + half):
        canvas.line_down(turn, STITCH)
    canvas.line_down(FRONT - half - canvas.turns(0.003), SEAM)
    radius = max(2, canvas.rows(0.006))
    for place in np.arange(canvas.marks.neck - 0.05, canvas.bottom + 0.03, -0.085):
        centre = canvas.px(FRONT, float(place))
        cv2.circle(canvas.relief, (centre[0] + 1, centre[1] + 1), radius + 1, -0.25, -1, LINE)
        cv2.circle(canvas.image, centre, radius, _button(canvas), -1, LINE)
        cv2.circle(canvas.relief, centre, radius, 0.12, -1, LINE)


def _button(canvas: Canvas) -> tuple[float, float, float]:
    """Colour (0-255) of buttons; darker on dark cloth."""
    dark = canvas.image.mean() < 110
    return (205.0, 200.0, 190.0) if dark else (238.0, 236.0, 230.0)


def cuffs(canvas: Canvas) -> None:
    """The buttoned cuffs of long sleeves."""
    if canvas.bottom < canvas.marks.elbow - 0.1:
        canvas.line_around(canvas.bottom + 0.06, SEAM, 2)
        centre = canvas.px(0.62, canvas.bottom + 0.03)
        cv2.circle(canvas.image, centre, 2, _button(canvas), -1, LINE)


def zipper(canvas: Canvas) -> None:
    """A metal zip down the front."""
    x, _ = canvas.px(FRONT, 0.0)
    half, rows = max(1, canvas.columns(0.005)), np.arange(canvas.panel.height)
    teeth = np.where((rows // 2) % 2 == 0, 190.0, 110.0).astype(np.float32)
    canvas.image[:, x - half : x + half] = teeth[:, None, None]
    for side in (-1, 1):
        canvas.line_down(FRONT + side * canvas.turns(0.014), STITCH)


def edges(canvas: Canvas) -> None:
    """Stitched edges of an open front, and patch pockets at its sides."""
    for side in (-1, 1):
        canvas.line_down(FRONT + side * canvas.turns(0.075), STITCH)
        _patch(canvas, FRONT + side * canvas.turns(0.16), canvas.bottom + 0.2, 0.12, 0.13)


def kangaroo(canvas: Canvas) -> None:
    """The belly pocket and the cords of a hoodie."""
    low = max(canvas.bottom + 0.06, canvas.marks.crotch)
    high, wide, narrow = low + 0.19, canvas.turns(0.15), canvas.turns(0.09)
    outline = [(FRONT - wide, low), (FRONT - wide, low + 0.07), (FRONT - narrow, high),
               (FRONT + narrow, high), (FRONT + wide, low + 0.07), (FRONT + wide, low)]  # fmt: skip
    canvas.line(outline, SEAM, 2)
    canvas.line(outline[1:3], -0.4, 3)
    canvas.line(outline[3:5], -0.4, 3)
    for side in (-1, 1):
        turn = FRONT + side * canvas.turns(0.035)
        start, end = canvas.px(turn, canvas.marks.neck), canvas.px(turn, canvas.marks.neck - 0.2)
        cv2.line(canvas.relief, (start[0] + 1, start[1]), (end[0] + 1, end[1]), -0.3, 2, LINE)
        cv2.line(canvas.image, start, end, (225.0, 222.0, 215.0), 2, LINE)


def chest_pocket(canvas: Canvas) -> None:
    """A patch pocket on the left chest."""
    _patch(canvas, FRONT + canvas.turns(0.085), canvas.marks.chest, 0.10, 0.12)


def front_pockets(canvas: Canvas) -> None:
    """Trousers: slanted pockets, the fly, and a waistband."""
    top = canvas.top - 0.04
    for side in (-1, 1):
        inner, outer = FRONT + side * canvas.turns(0.10), FRONT + side * canvas.turns(0.20)
        curve = [(inner, top), (inner + 0.2 * (outer - inner), top - 0.05),
                 (inner + 0.55 * (outer - inner), top - 0.085), (outer, top - 0.10)]  # fmt: skip
        canvas.line(curve, -0.38, 2)
    fly = FRONT + canvas.turns(0.028)
    canvas.line([(FRONT, top), (FRONT, canvas.marks.crotch)], SEAM, 2)
    canvas.line([(fly, top), (fly, top - 0.11), (FRONT, top - 0.15)], STITCH)
    canvas.line_around(top, SEAM, 2)


def back_pockets(canvas: Canvas) -> None:
    """Two patch pockets behind."""
    for turn in (canvas.turns(0.095), 1 - canvas.turns(0.095)):
        _patch(canvas, turn, canvas.top - 0.12, 0.13, 0.14)


def _patch(canvas: Canvas, turn: float, top: float, width: float, height: float) -> None:
    half = canvas.turns(width) / 2
    outline = [(turn - half, top), (turn - half, top - 0.85 * height), (turn, top - height),
               (turn + half, top - 0.85 * height), (turn + half, top)]  # fmt: skip
    canvas.line([*outline, outline[0]], SEAM)
    canvas.line([(turn - half, top - 0.012), (turn + half, top - 0.012)], STITCH)


def belt(canvas: Canvas) -> None:
    """A belt in the accent colour, and its buckle."""
    rows = canvas.band(canvas.top - 0.036, canvas.top)
    canvas.image[rows] = np.array(canvas.marks.accent, np.float32)
    canvas.relief[rows] += 0.05
    x, y = canvas.px(FRONT, canvas.top - 0.018)
    half, tall = canvas.columns(0.024), max(3, canvas.rows(0.018))
    corners = (x - half, y - tall), (x + half, y + tall)
    cv2.rectangle(canvas.image, *corners, (190.0, 186.0, 175.0), 2, LINE)
    canvas.line_around(canvas.top - 0.036, -0.4, 2)


def faded(canvas: Canvas) -> None:
    """Denim faded on the thighs and knees."""
    turns, along = canvas.panel.turns % 1, canvas.panel.along
    front = np.exp(-0.5 * ((turns - FRONT) / 0.13) ** 2)[None, :]
    thigh = np.exp(-0.5 * ((along + 0.2) / 0.12) ** 2)
    knee = np.exp(-0.5 * ((along - canvas.marks.knee) / 0.07) ** 2)
    share = (0.30 * front * (thigh + knee)[:, None])[..., None].astype(np.float32)
    canvas.dye((205.0, 212.0, 222.0), share)


def pressed(canvas: Canvas) -> None:
    """The ironed crease down the front of trouser legs."""
    canvas.line_down(FRONT, 0.14, 2)


def motif(canvas: Canvas) -> None:
    """A print on the chest: a disc, bars or blocks in the accent colour."""
    image, color = canvas.image, canvas.marks.accent
    kind = int(canvas.rng.integers(3))
    x, y = canvas.px(FRONT, canvas.marks.chest - 0.02)
    half, tall = canvas.columns(0.09), canvas.rows(0.08)
    if kind == 0:
        cv2.ellipse(image, (x, y), (half, tall), 0, 0, 360, color, -1, LINE)
        inner = tuple(float(c) for c in image[0, 0])
        cv2.ellipse(image, (x, y), (half // 2, tall // 2), 0, 0, 360, inner, -1, LINE)
    elif kind == 1:
        for i in range(3):
            row, right = y + (i - 1) * tall // 2, x + half - i * half // 3
            cv2.rectangle(image, (x - half, row), (right, row + tall // 4), color, -1, LINE)
    else:
        grid = np.repeat(np.repeat(canvas.rng.random((3, 5)) < 0.55, tall // 3, 0), half // 3, 1)
        patch = image[y - tall // 2 :, x - half :][: grid.shape[0], : grid.shape[1]]
        patch[grid[: patch.shape[0], : patch.shape[1]]] = color


def gradient(canvas: Canvas) -> None:
    """A gradient to the accent colour at the lower edge."""
    start = canvas.marks.chest if canvas.panel.piece == TORSO else -0.08
    share = np.clip((start - canvas.panel.along) / max(start - canvas.bottom, 0.05), 0, 1)
    share = (share * share * (3 - 2 * share)).astype(np.float32)[:, None, None]
    canvas.dye(canvas.marks.accent, share)


Paint = Callable[[Canvas], None]


def _on(pieces: tuple[int, ...], paint: Paint) -> dict[int, Paint]:
    return dict.fromkeys(pieces, paint)


_ALL, _TORSO = (TORSO, *ARMS, *LEGS), (TORSO,)
DETAILS: dict[str, Mapping[int, Paint]] = {
    "hems": _on(_ALL, hems),
    "ribs": _on(_ALL, ribs),
    "side_seams": _on(_ALL, side_seams),
    "placket": _on(_TORSO, placket) | _on(ARMS, cuffs),
    "zip": _on(_TORSO, zipper),
    "edges": _on(_TORSO, edges),
    "kangaroo": _on(_TORSO, kangaroo),
    "chest_pocket": _on(_TORSO, chest_pocket),
    "front_pockets": _on(_TORSO, front_pockets),
    "back_pockets": _on(_TORSO, back_pockets),
    "belt": _on(_TORSO, belt),
    "faded": _on(LEGS, faded),
    "pressed": _on(LEGS, pressed),
    "motif": _on(_TORSO, motif),
    "gradient": _on(_ALL, gradient),
}
"""Painting functions of details by name and by piece of the garment."""
