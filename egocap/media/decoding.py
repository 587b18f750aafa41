"""Decode an image file, after its header has said how large the image is."""

from __future__ import annotations

import io

import numpy as np
from numpy import ndarray as Array

from egocap.errors import InputError

MOST_PIXELS = 1 << 26
"""Of one image: 8192 x 8192."""

FORMATS = ("BMP", "JPEG", "PNG", "PPM", "TIFF", "WEBP")


def decode(data: bytes, flags: int) -> Array | None:
    """Decode an image with the flags of cv2.imdecode; None for a damaged file.

    Raises InputError for an image of more than MOST_PIXELS, before its pixels are allocated.
    """
    import cv2
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=FORMATS) as header:
            width, height = header.size
    except Image.DecompressionBombError as error:
        raise InputError(str(error), valid=f"at most {MOST_PIXELS} pixels") from None
    except Exception:  # Pillow's readers raise whatever a damaged header leads to
        return None
    if width * height > MOST_PIXELS:
        raise InputError(f"an image of {width} x {height}", valid=f"at most {MOST_PIXELS} pixels")
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
