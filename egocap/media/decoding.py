"""Decode an image file, after its header has said how large the image is."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from egocap.errors import FileError

MOST_PIXELS = 1 << 26
"""Of one image: 8192 x 8192."""

FORMATS = ("BMP", "JPEG", "PNG", "PPM", "TIFF", "WEBP")


def image_size(data: bytes, path: str | Path) -> tuple[int, int] | None:
    """Width and height by the header of an image file, `path`; None for a damaged file.

    Raises FileError for an image of more than MOST_PIXELS.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as header:
            width, height = header.size
    except Image.DecompressionBombError:
        width = height = MOST_PIXELS
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return None
    if width * height > MOST_PIXELS:
        raise FileError(path, "an image with too many pixels", valid=f"at most {MOST_PIXELS}")
    return width, height


def decode(data: bytes, flags: int, path: str | Path) -> Array | None:
    """Decode an image file, `path`, with the flags of cv2.imdecode; None for a damaged file.

    Raises FileError for an image of more than MOST_PIXELS, before its pixels are allocated.
    """
    import cv2

    if image_size(data, path) is None:
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
