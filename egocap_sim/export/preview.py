"""A contact sheet of a sequence: camera images with the truth drawn over them."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from egocap.body.labels import LABELS, LIMBS
from egocap.body.side_colours import MIDDLE, side_colour
from egocap.data.sequence import Sequence
from egocap.data.truth import OCCLUDED, OUT_OF_VIEW, SELF_OCCLUDED, VISIBLE
from egocap.errors import InputError
from egocap.files import make_folder, write_atomically

_RING = {VISIBLE: (255, 255, 255), SELF_OCCLUDED: (255, 60, 60), OCCLUDED: (200, 60, 255)}
_HEADER = 22  # px


def contact_sheet(
    sequence: Sequence, *, rows: int = 6, tile_width: int = 480
) -> UInt8[Array, "H W 3"]:
    """Draw evenly spaced frames, one a row: left, right, joints over the left view, part labels.

    Rings around joints: white if visible, red if self-occluded, violet if occluded by others.
    Frames without part labels lack the last column.
    """
    if not 1 <= rows <= 100 or not 64 <= tile_width <= 4096:
        raise InputError(
            f"a contact sheet of {rows} rows of pictures {tile_width} px wide",
            valid="1 to 100 rows, 64 to 4096 px",
        )
    indices = np.unique(np.linspace(0, len(sequence) - 1, rows).round().astype(int))
    return _stacked([_row(sequence, int(i), tile_width) for i in indices])


def save_contact_sheet(
    folders: Collection[Path], path: Path, *, rows: int, tile_width: int
) -> None:
    """Write the `contact_sheet` of a sequence as PNG or JPEG, by the file's suffix; of several, the
    middle frame of each of `rows` of them."""
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"cannot write '{path.name}'", valid="a name that ends in .png or .jpg")
    if len(folders) == 1:
        sheet = contact_sheet(Sequence(*folders), rows=rows, tile_width=tile_width)
    else:
        chosen = np.unique(np.linspace(0, len(folders) - 1, rows).round().astype(int))
        opened = [Sequence(list(folders)[i]) for i in chosen]
        sheet = _stacked([_row(sequence, len(sequence) // 2, tile_width) for sequence in opened])
    done, data = cv2.imencode(path.suffix.lower(), sheet[..., ::-1])
    assert done, f"encoding of a sheet of shape {sheet.shape} failed"
    make_folder(path.parent)
    write_atomically(path, data.tobytes())


def overlay(
    image: UInt8[Array, "H W 3"],
    joints: Float[Array, "18 2"],
    drawn: Bool[Array, "18"],
    visibility: UInt8[Array, "18"],
) -> UInt8[Array, "H W 3"]:
    """Draw a pose's limbs and joints over an image; `joints` are pixels of that image."""
    canvas = image.copy()
    thickness = max(1, image.shape[1] // 240)
    for a, b in LIMBS:
        if drawn[a] and drawn[b]:
            ends = _point(joints[a]), _point(joints[b])
            cv2.line(canvas, *ends, _colour(a, b), thickness, cv2.LINE_AA, 4)
    for j in np.flatnonzero(drawn):
        ring = _RING.get(int(visibility[j]), (128, 128, 128))
        cv2.circle(canvas, _point(joints[j]), 3 * thickness * 16, ring, thickness, cv2.LINE_AA, 4)
    return canvas


def _row(sequence: Sequence, index: int, width: int) -> UInt8[Array, "h w 3"]:
    frame, truth = sequence.frame(index), sequence.truth
    tiles = list(zip(sequence.manifest.views, frame.images, strict=True))
    visibility = truth.visibility[index, 0]
    joints = overlay(
        frame.images[0], truth.joints_2d[index, 0], visibility != OUT_OF_VIEW, visibility
    )
    tiles.append((f"{tiles[0][0]}: joints", joints))
    mask = sequence.mask(index, sequence.manifest.views[0])
    if mask is not None:
        tiles.append((f"{tiles[0][0]}: parts", _palette()[mask]))
    prefix = f"{sequence.manifest.name} {index} ({frame.time:.2f} s)"
    return np.hstack([_tile(image, f"{prefix} {title}", width) for title, image in tiles])


def _stacked(rows: list[UInt8[Array, "h w 3"]]) -> UInt8[Array, "H W 3"]:
    """Rows of any number of tiles below each other, black on the right of shorter ones."""
    width = max(row.shape[1] for row in rows)
    return np.vstack([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows])


def _tile(image: UInt8[Array, "H W 3"], caption: str, width: int) -> UInt8[Array, "h w 3"]:
    height = round(image.shape[0] * width / image.shape[1])
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    tile = np.full((height + _HEADER, width, 3), 24, np.uint8)
    tile[_HEADER:] = small
    cv2.putText(
        tile, caption, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (230, 230, 230), 1, cv2.LINE_AA
    )
    return tile


def _point(pixel: Float[Array, "2"]) -> tuple[int, int]:
    """A pixel in OpenCV's fixed-point drawing coordinates (4 fractional bits)."""
    x, y = np.rint(pixel * 16).astype(int)
    return int(x), int(y)


def _colour(a: int, b: int) -> tuple[int, int, int]:
    """Of a limb: of its side, or of the middle between the sides."""
    first, second = side_colour(LABELS[a]), side_colour(LABELS[b])
    return first if first == second else MIDDLE


def _palette() -> UInt8[Array, "256 3"]:
    """A colour for every part label: spaced hues for the wearer, greys for the room."""
    labels = np.arange(256)
    hsv = np.stack([(labels * 67) % 180, np.full(256, 190), np.full(256, 235)], -1)
    hsv[labels >= 100, 1] = 40
    hsv[labels >= 100, 2] = 90 + (labels[labels >= 100] * 29) % 90
    colours = cv2.cvtColor(hsv[None].astype(np.uint8), cv2.COLOR_HSV2RGB)[0]
    colours[0] = 0
    return colours
